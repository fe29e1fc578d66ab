"""Clusters of Dask and Ray on loopback, started by the commands that users run."""

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
    """Environment of a worker: our packages, none of the run's own settings but Ray's token."""
    inherited = {
        k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "SLGAUSSIAN_"))
    }
    return inherited | {
        # With it, some servers that Ray's head forks for its clients die at once.
        "GRPC_ENABLE_FORK_SUPPORT": "0",
        # Retries of Dask for a task whose worker died; its default is 3.
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
        "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent.parent)]),
    }


@contextmanager
def dask_cluster(workers: int = 1) -> Iterator[str]:
    """Start a Dask cluster; yields its address as a ``runner``."""
    port = free_port()
    scheduler = f"tcp://{LOOPBACK}:{port}"
    common = ["--host", LOOPBACK, "--no-dashboard"]
    options = ["--nworkers", str(workers), "--nthreads", "1", "--death-timeout", "60"]
    with (
        tempfile.TemporaryDirectory(prefix="slg-") as folder,
        Path(folder, "log").open("wb") as log,
        ExitStack() as stack,
    ):
        stack.enter_context(running(log, "dask", "scheduler", *common, "--port", port))
        if workers:
            words = [scheduler, *common, *options, "--local-directory", folder]
            stack.enter_context(running(log, "dask", "worker", *words))
        wait_for_port(port)
        yield f"dask://{LOOPBACK}:{port}"


@contextmanager
def ray_cluster() -> Iterator[str]:
    """Start a Ray cluster of one core; yields its address as a ``runner``."""
    port = free_port()
    # Not in pytest's folder: the paths of Ray's sockets would be too long.
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
            running(log, "ray", "start", "--head", "--block", "--disable-usage-stats", *words),
        ):
            wait_for_port(port)
            yield f"ray://{LOOPBACK}:{port}"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def running(log, program: str, *words: str) -> Iterator[None]:
    """Run a program of the virtual environment; stop it and its children at the end."""
    process = subprocess.Popen(
        [BIN / program, *words],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        start_new_session=True,
    )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for_port(port: str) -> None:
    """Return when a server listens on the port."""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        try:
            socket.create_connection((LOOPBACK, int(port)), 1).close()
            return
        except OSError:
            time.sleep(0.1)
    raise TimeoutError(port)


def free_port() -> str:
    with socket.create_server((LOOPBACK, 0)) as server:
        return str(server.getsockname()[1])
