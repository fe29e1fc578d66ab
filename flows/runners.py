"""Who does the work of a flow: threads, processes, or the workers of a Dask or Ray cluster."""

from __future__ import annotations

import fcntl
import logging
import multiprocessing
import os
import secrets
import shutil
import signal
import socket
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from multiprocessing.connection import wait
from pathlib import Path
from types import ModuleType
from urllib.parse import urlsplit

from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from flows.server import LOOPBACK
from slgaussian.errors import InputError, one_line
from slgaussian.store import ArtifactStore
from tasks.shard import NO_EVENTS

CONNECT = 10.0
"""Seconds to wait for a cluster that is said to run."""

SCRATCH = "slg-cluster-"
"""How the temporary folders of clusters begin."""


def check_runner(runner: str, store: ArtifactStore) -> None:
    """Raise :class:`InputError` if a runner cannot work, as far as that can be told at once.

    Parameters
    ----------
    runner : str
        As :data:`flows.settings.Runner` has it.
    store : ArtifactStore
        The one that its workers are to use.

    Raises
    ------
    InputError
        If the package of the runner is not installed, its cluster does not answer, or its workers
        could not reach the store or the Prefect server.
    """
    kind, _, address = runner.partition("://")
    if kind != "threads" and store.near and not store.local:
        raise InputError(
            f"runner: found {runner!r}, whose workers cannot see the store {store.root}, which is "
            "in the memory of this process; choose a folder or a bucket with --store, or the "
            "runner threads"
        )
    if kind in ("dask", "ray"):
        _imported(f"prefect_{kind}", kind)
    if address:
        _check_server(runner)
        place = urlsplit(runner)
        try:
            socket.create_connection((place.hostname, place.port), CONNECT).close()
        except OSError as error:
            raise InputError(_nobody(runner, error)) from error


@contextmanager
def started(runner: str, workers: int, store: ArtifactStore) -> Iterator[TaskRunner]:
    """The task runner of a name, for a flow; its cluster, if it is ours, runs within the block.

    Parameters
    ----------
    runner, store
        As for :func:`check_runner`.
    workers : int
        How many tasks are run at the same time.

    Raises
    ------
    InputError
        As :func:`check_runner`, or if the cluster cannot be started or refuses us.
    """
    check_runner(runner, store)
    kind, _, address = runner.partition("://")
    if kind == "threads":
        yield _Threads(max_workers=workers)
    elif kind == "processes":
        yield _Processes(max_workers=workers, initializer=leave_with_parent)
    else:
        cluster = {"dask": _dask, "ray": _ray}[kind]
        with cluster(address, workers) as task_runner:
            yield task_runner


def abandon(runner: TaskRunner) -> None:
    """Have nobody wait for what its workers are at: the run is to end now."""
    if isinstance(runner, _Threads):
        runner.abandon()
    for process in multiprocessing.active_children():
        process.kill()


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Have threads and processes that begin within the block not hear Ctrl-C.

    A terminal sends it to all processes of a program; it is for this one, which ends the others.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave_with_parent() -> None:
    """End this process of a pool once its parent is gone, however that died."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _Threads(ThreadPoolTaskRunner):
    def abandon(self) -> None:
        """Have its end not wait for the threads, which end with what they are at."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        self._executor = None


class _Processes(ProcessPoolTaskRunner):
    def __reduce__(self) -> tuple[type[TaskRunner], tuple[int]]:
        # Each worker would begin a pool of its own, for tasks of tasks, as Prefect does it.
        return ThreadPoolTaskRunner, (1,)


@contextmanager
def _dask(address: str, workers: int) -> Iterator[TaskRunner]:
    import dask
    from distributed import Client, LocalCluster
    from prefect_dask import DaskTaskRunner

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if address:
        url = f"tcp://{address}"
        try:
            Client(url, timeout=CONNECT, set_as_default=False).close()
        except (OSError, ValueError) as error:
            raise InputError(_nobody(f"dask://{address}", error)) from error
        yield DaskTaskRunner(address=url)
        return
    # Chains whose worker died are tried again by us, one by one.
    settings = {"distributed.scheduler.allowed-failures": 0}
    with ExitStack() as stack:
        folder = stack.enter_context(_scratch())
        stack.enter_context(dask.config.set(settings))
        with without_interrupts():
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host=LOOPBACK,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
                local_directory=folder,
                # As of threads and processes: a share of the memory would end what needs more.
                memory_limit=0,
            )
        yield DaskTaskRunner(address=stack.enter_context(cluster).scheduler_address)


@contextmanager
def _ray(address: str, workers: int) -> Iterator[TaskRunner]:
    import ray
    from prefect_ray import RayTaskRunner
    from prefect_ray.context import remote_options

    quiet = {"log_to_driver": False, "logging_level": "CRITICAL", "namespace": "slgaussian"}
    terminated = signal.getsignal(signal.SIGTERM)
    with ExitStack() as stack:
        try:
            if address:
                own = {name: "1" for name in (NO_EVENTS,) if name in os.environ}
                with warnings.catch_warnings(action="ignore"):
                    ray.init(f"ray://{address}", runtime_env={"env_vars": own}, **quiet)
            else:
                # Who reaches Ray can have it run code, and others may on loopback; without this, it
                # keeps a token in the home folder for all to read.
                stack.enter_context(_environment("RAY_AUTH_TOKEN", secrets.token_hex(32)))
                ray.init(
                    "local",
                    num_cpus=workers,
                    include_dashboard=False,
                    _node_ip_address=LOOPBACK,
                    _temp_dir=stack.enter_context(_scratch()),
                    # Nothing large goes through it, and it would take a third of the memory.
                    object_store_memory=100 * 2**20,
                    **quiet,
                )
        except Exception as error:  # Ray's own, and any
            what = f"the cluster at ray://{address} refuses us" if address else "Ray cannot start"
            raise InputError(f"runner: {what} ({one_line(error)})") from error
        finally:
            signal.signal(signal.SIGTERM, terminated)  # which Ray takes for itself
        stack.callback(ray.shutdown)
        # As with Dask, we try again ourselves.
        stack.enter_context(remote_options(max_retries=0))
        yield RayTaskRunner()


@contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


@contextmanager
def _scratch() -> Iterator[str]:
    """A temporary folder for a cluster; what killed programs left of theirs is removed, too."""
    for left in Path(tempfile.gettempdir()).glob(f"{SCRATCH}*"):
        with suppress(OSError), _locked(left):
            shutil.rmtree(left)
    # Its path is short, as Ray has its sockets in it.
    made = tempfile.TemporaryDirectory(prefix=SCRATCH, ignore_cleanup_errors=True)
    with made as folder, _locked(folder):
        yield folder


@contextmanager
def _locked(folder: str | Path) -> Iterator[None]:
    """Hold a folder; BlockingIOError if a living program does. Who dies, lets go."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def _imported(module: str, extra: str) -> ModuleType:
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"runner: {extra} is not installed ({error}); install it with "
            f'`pip install "slgaussian[{extra}]"`'
        ) from error


def _check_server(runner: str) -> None:
    near = (LOOPBACK, "localhost", "::1")
    server = urlsplit(os.environ.get("PREFECT_API_URL", "")).hostname
    if urlsplit(runner).hostname not in near and server in near:
        raise InputError(
            f"runner: found {runner!r}, whose workers cannot reach the Prefect server of this run, "
            "which is on loopback; start one that they can with `prefect server start --host "
            "0.0.0.0`, and set PREFECT_API_URL to its address"
        )


def _nobody(runner: str, error: Exception) -> str:
    what = "Dask scheduler" if runner.startswith("dask") else "Ray head"
    said = str(error) or type(error).__name__
    return f"runner: no {what} answers at {runner} ({said}); start it, or correct the address"
