"""Prefect task runners by name: threads, processes, or the workers of a Dask or Ray cluster."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import signal
import socket
import tempfile
import threading
import urllib.request
import uuid
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from multiprocessing.connection import wait
from typing import Any
from urllib.parse import urlsplit

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.events.clients import NullEventsClient
from prefect.events.worker import EventsWorker
from prefect.futures import PrefectFuture
from prefect.logging.handlers import set_api_log_sink
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from flows.runners.environment import ray_variables
from flows.runners.server import LOOPBACK
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.extras import install_line
from slgaussian.storage.remote import redacted
from slgaussian.storage.store import ArtifactStore, DamagedError

CONNECT = 5.0
"""Seconds to wait for a cluster that is said to run."""

PATIENCE = 120.0
"""Seconds that the workers of a cluster may take to begin."""

ANSWER = 10.0
"""Seconds that the Prefect server may take to answer a worker."""

NO_EVENTS = "SLGAUSSIAN_NO_EVENTS"
"""Environment variable that is set if nobody reads the events that Prefect has of every task: they
cost a worker and the server some 25 ms a task, and the database 25 kB."""


def send_events(wanted: bool) -> None:
    """Have this process send Prefect's events to the server itself, or nowhere."""
    EventsWorker.set_client_override(None if wanted else NullEventsClient)


if NO_EVENTS in os.environ:
    send_events(False)  # a worker loads this module with its first task, before any event of it


@dataclass
class Workers:
    """The workers of a flow; made by :func:`open_workers`.

    Attributes
    ----------
    store : ArtifactStore
        The one that they use.
    count : int
        How many tasks run at the same time.
    refresh : frozenset of str
        Stages to compute anew.
    runner : TaskRunner
    """

    store: ArtifactStore
    count: int
    refresh: frozenset[str]
    runner: TaskRunner[Any]
    stack: ExitStack

    def submit(self, prefect_task: Task[..., Any], parameters: dict[str, Any]) -> PrefectFuture:
        """Have a worker run a task; SLGaussianError if the task runner takes on no more."""
        try:
            with without_interrupts():
                return self.runner.submit(prefect_task, parameters)
        except Exception as error:  # each task runner has its own
            reason = one_line(f"{type(error).__name__}: {error}")
            raise SLGaussianError(
                f"runner: takes on no more work ({reason}); what was made is in the store: if the "
                "cluster has gone, start it, and the same command goes on"
            ) from error

    def restart(self, broken: TaskRunner[Any]) -> None:
        """Replace a pool of processes, which is of no use once one of them has died."""
        if broken is self.runner and isinstance(broken, ProcessPoolTaskRunner):
            self.runner = self.stack.enter_context(broken.duplicate())


@contextmanager
def open_workers(
    name: str, count: int, store: ArtifactStore, refresh: frozenset[str] = frozenset()
) -> Iterator[Workers]:
    """Open the task runner of a name, within a Prefect flow.

    When the block is left by a signal nobody waits for the workers: the program is to end now.

    Raises
    ------
    InputError
        As :func:`check_runner`, if the cluster refuses us, or no worker of it can do the work.
    """
    check_runner(name, store)
    stack = ExitStack()
    try:
        workers = Workers(
            store, count, refresh, stack.enter_context(_task_runner(name, count)), stack
        )
        if "://" in name:
            _check_workers(name, workers)
        yield workers
    except Exception:
        stack.close()
        raise
    except BaseException:
        stack.pop_all()
        for process in multiprocessing.active_children():
            process.kill()
        raise
    else:
        stack.close()


def _task_runner(name: str, count: int) -> Any:
    kind, _, address = name.partition("://")
    if kind == "threads":
        return ThreadPoolTaskRunner(max_workers=count)
    if kind == "processes":
        return ProcessPoolTaskRunner(max_workers=count, initializer=become_worker)
    return {"dask": _dask, "ray": _ray}[kind](address)


@task(name="roll-call", cache_policy=NO_CACHE, persist_result=False)
def roll_call(root: str, probe: str, server: str) -> None:
    """Raise InputError where a worker is that cannot do its work.

    Parameters
    ----------
    root : str
        The store.
    probe : str
        A file that is in it.
    server : str
        URL of the Prefect server's API.
    """
    store = ArtifactStore(root)
    try:
        store.check_there(probe)
    except DamagedError as error:
        raise InputError(f"it has another store at {store.root}") from error
    store.check_writable()
    try:
        urllib.request.urlopen(f"{server}/health", timeout=ANSWER).close()
    except OSError as error:
        raise InputError(f"it does not reach the server at {redacted(server)}: {error}") from error


def _check_workers(name: str, workers: Workers) -> None:
    """Wait for a worker that can do the work; InputError if one cannot, or there is none."""
    store, probe = workers.store, f".probe-{uuid.uuid4().hex}"
    store.write(probe, b"")
    parameters = {"root": store.root, "probe": probe, "server": os.environ["PREFECT_API_URL"]}
    try:
        workers.submit(roll_call, parameters).result(timeout=PATIENCE)
    except TimeoutError as error:
        raise InputError(
            f"runner: no worker of {name} took on any work within {PATIENCE:.0f} s; start one, or "
            "wait until one is free"
        ) from error
    except Exception as error:  # each task runner has its own
        raise InputError(
            f"runner: a worker of {name} cannot do the work ({last_line(str(error))}); it needs "
            "the packages that are installed here, and the same store and server within its reach"
        ) from error
    finally:
        store.remove([probe])


def check_runner(runner: str, store: ArtifactStore) -> None:
    """Raise :class:`InputError` if a runner cannot work, as far as that can be told at once.

    Parameters
    ----------
    runner : str
        As :data:`flows.config.Runner` has it.
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
    if address:
        try:
            import_module(f"prefect_{kind}")
        except ImportError as error:
            raise InputError(
                f"runner: {kind} is not installed ({error}); install it with {install_line(kind)}"
            ) from error
        near, place = (LOOPBACK, "localhost", "::1"), urlsplit(runner)
        server = urlsplit(os.environ.get("PREFECT_API_URL", "")).hostname
        if place.hostname not in near and server in near:
            raise InputError(
                f"runner: found {runner!r}, whose workers cannot reach the Prefect server of this "
                "run, which is on loopback; start one that they can with `prefect server start "
                "--host 0.0.0.0`, and set PREFECT_API_URL to its address"
            )
        try:
            socket.create_connection((place.hostname, place.port), CONNECT).close()
        except OSError as error:
            raise InputError(_nobody(runner, error)) from error


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
    send_events(NO_EVENTS not in os.environ)
    set_api_log_sink(None)
    parent = multiprocessing.parent_process()
    assert parent is not None  # a process of a pool has one

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


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
    with DaskTaskRunner(address=url) as task_runner:
        yield task_runner


@contextmanager
def _ray(address: str) -> Iterator[TaskRunner[Any]]:
    for name, value in ray_variables().items():
        os.environ.setdefault(name, value)
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
        before = signal.getsignal(signal.SIGTERM)  # which Ray takes for itself
        try:
            # Ray has its workers look for modules where its client is, first: an empty folder.
            with (
                tempfile.TemporaryDirectory() as empty,
                chdir(empty),
                warnings.catch_warnings(action="ignore"),
            ):
                try:
                    connect()
                except ConnectionAbortedError:
                    # A process that its head forks for a client may die at once, of gRPC's threads.
                    connect()
        except Exception as error:  # Ray's own, and any
            raise InputError(
                f"runner: the Ray cluster at {url} refuses us ({last_line(str(error))}); if it "
                "wants a token, give it in RAY_AUTH_TOKEN"
            ) from error
        finally:
            signal.signal(signal.SIGTERM, before)
        stack.callback(ray.shutdown)
        # Whose worker died is tried again by us, chain by chain.
        stack.enter_context(remote_options(max_retries=0))
        yield stack.enter_context(RayTaskRunner())


def last_line(text: str) -> str:
    """Return the last line of an error, which may bring another process's traceback along."""
    return (text.strip().splitlines() or ["unknown"])[-1].strip()


def _nobody(runner: str, error: Exception) -> str:
    what = "Dask scheduler" if runner.startswith("dask") else "Ray head"
    said = str(error) or type(error).__name__
    return f"runner: no {what} answers at {runner} ({said}); start it, or correct the address"
