"""Who does the work of a flow: threads, processes, or the workers of a Dask or Ray cluster."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import signal
import socket
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, chdir, contextmanager
from functools import partial
from importlib import import_module
from multiprocessing.connection import wait
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

from prefect.events.worker import EventsWorker
from prefect.logging.handlers import set_api_log_sink
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from flows.runners.server import LOOPBACK
from flows.runners.shard import NO_EVENTS, send_no_events
from slgaussian.errors import InputError
from slgaussian.parts.extras import install_line
from slgaussian.storage.store import ArtifactStore

CONNECT = 5.0
"""Seconds to wait for a cluster that is said to run."""


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
def started(runner: str, workers: int, store: ArtifactStore) -> Iterator[TaskRunner[Any]]:
    """Make the task runner of a name, for a flow.

    Parameters
    ----------
    runner, store
        As for :func:`check_runner`.
    workers : int
        How many tasks are run at the same time.

    Raises
    ------
    InputError
        As :func:`check_runner`, or if the cluster refuses us.
    """
    check_runner(runner, store)
    kind, _, address = runner.partition("://")
    if kind == "threads":
        yield _Threads(max_workers=workers)
    elif kind == "processes":
        yield _Processes(max_workers=workers, initializer=become_worker)
    else:
        with {"dask": _dask, "ray": _ray}[kind](address) as task_runner:
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


def become_worker() -> None:
    """Have this process of a pool end once its parent is gone, however that died.

    And tell Prefect's server itself what it has to tell. Prefect has it told to the parent by a
    queue: a worker that is killed may hold its lock, and then the parent never ends.
    """
    if NO_EVENTS not in os.environ:
        EventsWorker.set_client_override(None)
    else:
        send_no_events()
    set_api_log_sink(None)
    parent = multiprocessing.parent_process()
    assert parent is not None  # a process of a pool has one

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _Threads(ThreadPoolTaskRunner):
    def abandon(self) -> None:
        """Have its end not wait for the threads, which end with what they are at."""
        if self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
            self._executor = None


class _Processes(ProcessPoolTaskRunner):
    def __reduce__(self) -> tuple[type[TaskRunner], tuple[int]]:
        # Each worker would begin a pool of its own, for tasks of tasks, as Prefect does it.
        return ThreadPoolTaskRunner, (1,)


@contextmanager
def _dask(address: str) -> Iterator[TaskRunner[Any]]:
    from distributed.comm import connect
    from prefect_dask import DaskTaskRunner

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    url = f"tcp://{address}"

    async def greet() -> None:
        comm = await connect(url, timeout=CONNECT)
        await comm.close()

    try:
        # Dask's clients wait for ever for the first words of what is no scheduler.
        asyncio.run(asyncio.wait_for(greet(), 2 * CONNECT))
    except (OSError, ValueError) as error:
        raise InputError(_nobody(f"dask://{address}", error)) from error
    yield DaskTaskRunner(address=url)


@contextmanager
def _ray(address: str) -> Iterator[TaskRunner[Any]]:
    import ray
    from prefect_ray import RayTaskRunner
    from prefect_ray.context import remote_options

    with ExitStack() as stack:
        url = f"ray://{address}"
        variables = {name: os.environ[name] for name in (NO_EVENTS,) if name in os.environ}
        connect = partial(
            ray.init,
            url,
            namespace="slgaussian",
            runtime_env={"env_vars": variables},
            log_to_driver=False,
            logging_level=logging.CRITICAL,
        )
        try:
            with _own_signals(), _elsewhere(), warnings.catch_warnings(action="ignore"):
                try:
                    connect()
                except ConnectionAbortedError:
                    # A process that its head forks for a client may die at once, of gRPC's threads.
                    connect()
        except Exception as error:  # Ray's own, and any
            said = last_line(str(error))
            raise InputError(
                f"runner: the Ray cluster at {url} refuses us ({said}); if it wants a token, give "
                "it in RAY_AUTH_TOKEN"
            ) from error
        stack.callback(ray.shutdown)
        # Whose worker died is tried again by us, chain by chain.
        stack.enter_context(remote_options(max_retries=0))
        yield RayTaskRunner()


@contextmanager
def _own_signals() -> Iterator[None]:
    """Keep what SIGTERM does, which Ray takes for itself."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _elsewhere() -> Iterator[None]:
    """Be in an empty folder: Ray has its workers look for modules where its client is, first."""
    with tempfile.TemporaryDirectory() as empty, chdir(empty):
        yield


def _imported(module: str, extra: str) -> ModuleType:
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"runner: {extra} is not installed ({error}); install it with {install_line(extra)}"
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


def last_line(text: str) -> str:
    """Return the last line of an error, which may bring another process's traceback along."""
    return (text.strip().splitlines() or ["unknown"])[-1].strip()


def _nobody(runner: str, error: Exception) -> str:
    what = "Dask scheduler" if runner.startswith("dask") else "Ray head"
    said = str(error) or type(error).__name__
    return f"runner: no {what} answers at {runner} ({said}); start it, or correct the address"
