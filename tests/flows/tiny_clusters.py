"""Clusters of Dask and Ray as their users start them, on loopback, for the tests to run on."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

BIN = Path(sys.executable).parent
HERE = Path(__file__).parent
LOOPBACK = "127.0.0.1"


def environment() -> dict[str, str]:
    """What a worker finds: our packages, and nothing of the run's own settings but Ray's token."""
    local = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "SLGAUSSIAN_"))}
    path = os.pathsep.join([str(HERE), str(HERE.parent.parent)])
    variables = {
        # With it, some servers that Ray's head forks for its clients die at once.
        "GRPC_ENABLE_FORK_SUPPORT": "0",
        # So often Dask itself tries what its worker died of; three times, if not told.
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
    }
    return {**local, **variables, "PYTHONPATH": path}


@contextmanager
def dask_cluster(workers: int = 1) -> Iterator[str]:
    """The runner that has its work done by a new Dask cluster."""
    place = f"{LOOPBACK}:{free_port()}"
    host, port = place.split(":")
    common = ["--host", host, "--no-dashboard"]
    work = ["--nworkers", str(workers), "--nthreads", "1", "--death-timeout", "60"]
    with (
        tempfile.TemporaryDirectory(prefix="slg-") as folder,
        Path(folder, "log").open("wb") as log,
        ExitStack() as stack,
    ):
        stack.enter_context(begun(log, "dask", "scheduler", *common, "--port", port))
        if workers:
            local = [f"tcp://{place}", *common, *work, "--local-directory", folder]
            stack.enter_context(begun(log, "dask", "worker", *local))
        wait_for(place)
        yield f"dask://{place}"


@contextmanager
def ray_cluster() -> Iterator[str]:
    """The runner that has its work done by a new Ray cluster of one core."""
    port = free_port()
    # Not pytest's own: the paths of Ray's sockets would be too long.
    folder = tempfile.mkdtemp(prefix="slg-", dir="/tmp")
    options = {
        "node-ip-address": LOOPBACK,
        "port": free_port(),
        "ray-client-server-port": port,
        "include-dashboard": "false",
        "temp-dir": folder,
        "num-cpus": 1,
        "object-store-memory": 80_000_000,
    }
    words = [f"--{name}={value}" for name, value in options.items()]
    try:
        with (
            Path(folder, "log").open("wb") as log,
            begun(log, "ray", "start", "--head", "--block", "--disable-usage-stats", *words),
        ):
            wait_for(f"{LOOPBACK}:{port}")
            yield f"ray://{LOOPBACK}:{port}"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def begun(log, *command: str) -> Iterator[subprocess.Popen]:
    """A program of the virtual environment, stopped with all that it began."""
    process = subprocess.Popen(
        [BIN / command[0], *command[1:]],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for(place: str) -> None:
    """Until something listens there."""
    host, port = place.split(":")
    end = time.monotonic() + 120
    while time.monotonic() < end:
        try:
            socket.create_connection((host, int(port)), 1).close()
            return
        except OSError:
            time.sleep(0.1)
    raise TimeoutError(place)


def free_port() -> str:
    with socket.create_server((LOOPBACK, 0)) as server:
        return str(server.getsockname()[1])
