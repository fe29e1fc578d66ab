"""Prefect task runners by name: threads, processes, or the workers of a Dask or Ray cluster."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import secrets
import signal
import socket
import tempfile
import threading
import uuid
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, chdir, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from prefect import Task, task
from prefect.cache_policies import NO_CACHE
from prefect.events.clients import NullEventsClient
from prefect.events.worker import EventsWorker
from prefect.futures import PrefectFuture
from prefect.logging.handlers import set_api_log_sink
from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from flows.config import Engine
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.extras import install_line
from slgaussian.storage.store import ArtifactStore, DamagedError
from slgaussian.system import without_interrupts

CONNECT_TIMEOUT = 5.0
"""Timeout of the connection to a cluster, seconds."""

FIRST_TASK_TIMEOUT = 120.0
"""Timeout of the first task on a cluster, seconds."""

CLUSTERS = {
    "dask": ("Dask scheduler", "8786, and 8787 that of its dashboard"),
    "ray": ("head of Ray", "10001"),
}
"""Name of the server of each cluster, and its usual port."""

NO_EVENTS = "SLGAUSSIAN_NO_EVENTS"
"""Environment variable that disables Prefect's task events, which cost worker and server some 25 ms
for each task, and the database 25 kB."""


def send_events(wanted: bool) -> None:
    """Enable or disable Prefect's events of this process."""
    EventsWorker.set_client_override(None if wanted else NullEventsClient)


if NO_EVENTS in os.environ:
    send_events(False)  # workers import this module before the first event


@dataclass
class Workers:
    """The workers of a flow; made by :func:`open_workers`.

    Attributes:
        store: Store of the results.
        stack: Holds all task runners open.
    """

    config: Engine
    store: ArtifactStore
    runner: TaskRunner[Any]
    stack: ExitStack

    def submit(self, prefect_task: Task[..., Any], parameters: dict[str, Any]) -> PrefectFuture:
        """Submit a task to a worker; SLGaussianError if the task runner accepts no more."""
        try:
            with without_interrupts():
                return self.runner.submit(prefect_task, parameters)
        except Exception as error:  # each task runner has its own
            reason = one_line(f"{type(error).__name__}: {error}")
            raise SLGaussianError(
                f"runner: accepts no more work ({reason}); finished stages are in the store: if "
                "the cluster has stopped, start it, and the same command continues"
            ) from error

    def restart(self, broken: TaskRunner[Any]) -> None:
        """Replace a process pool, which is broken after the death of one process."""
        if broken is self.runner and isinstance(broken, ProcessPoolTaskRunner):
            self.runner = self.stack.enter_context(broken.duplicate())


@contextmanager
def open_workers(config: Engine, store: ArtifactStore) -> Iterator[Workers]:
    """Open the task runner of a configuration, within a Prefect flow.

    When a signal ends the block, workers are killed, so that the program ends immediately.

    Raises:
        InputError: As :func:`check_runner`, if the cluster refuses the connection, or no worker can
            do the work.
    """
    check_runner(config.runner)
    with ExitStack() as stack:
        try:
            runner = stack.enter_context(_task_runner(config.runner, config.workers))
            workers = Workers(config, store, runner, stack)
            if "://" in config.runner:
                _check_workers(workers)
            yield workers
        except BaseException as error:
            if not isinstance(error, Exception):
                stack.pop_all()  # does not wait for the workers
                for process in multiprocessing.active_children():
                    process.kill()
            raise


def _task_runner(name: str, count: int) -> AbstractContextManager[TaskRunner[Any]]:
    if name == "threads":
        return ThreadPoolTaskRunner(max_workers=count)
    if name == "processes":
        return ProcessPoolTaskRunner(max_workers=count, initializer=become_worker)
    if name.startswith("ray"):
        return _ray(name)
    from prefect_dask import DaskTaskRunner

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    return DaskTaskRunner(address=name.replace("dask", "tcp", 1))


@task(name="roll-call", cache_policy=NO_CACHE, persist_result=False)
def roll_call(root: str, probe: str) -> None:
    """Test from a worker that the store ``root``, which has a file ``probe``, is its own too."""
    store = ArtifactStore(root)
    try:
        store.check_exists(probe)
    except DamagedError as error:
        raise InputError(f"it has another store at {store.root}") from error
    store.check_writable()


def _check_workers(workers: Workers) -> None:
    """Run :func:`roll_call` on a worker; InputError if it fails, or there is no worker."""
    name, store, probe = workers.config.runner, workers.store, f".probe-{uuid.uuid4().hex}"
    store.write(probe, b"")
    parameters = {"root": store.root, "probe": probe}
    try:
        workers.submit(roll_call, parameters).result(timeout=FIRST_TASK_TIMEOUT)
    except TimeoutError as error:
        raise InputError(
            f"runner: no worker of {name} accepted work within {FIRST_TASK_TIMEOUT:.0f} s; start "
            "one, or wait until one is free"
        ) from error
    except Exception as error:  # each task runner has its own
        raise InputError(
            f"runner: a worker of {name} cannot do the work ({last_line(str(error))}); it needs "
            "the packages that are installed here, and the same store and server within its reach"
        ) from error
    finally:
        store.remove([probe])


def check_runner(runner: str) -> None:
    """Check a runner (:data:`flows.config.Runner`) as far as possible before its start.

    Raises:
        InputError: If the package of the runner is not installed, or its cluster does not answer.
    """
    place = urlsplit(runner)
    kind = place.scheme
    if kind not in CLUSTERS:
        return
    server, port = CLUSTERS[kind]
    if kind == "ray":
        _set_ray_variables()
    try:
        import_module(f"prefect_{kind}")
    except ImportError as error:
        raise InputError(
            f"runner: {kind} is not installed ({error}); install it with {install_line(kind)}"
        ) from error
    try:
        socket.create_connection((place.hostname, place.port), CONNECT_TIMEOUT).close()
        if kind == "dask":
            asyncio.run(_greet(f"tcp://{place.netloc}"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"runner: no {server} answers at {runner} ({error}); start the cluster, or correct the "
            f"address: its port is often {port}"
        ) from error


async def _greet(url: str) -> None:
    """Raise OSError if no Dask scheduler is at a URL, for which Dask's clients wait forever."""
    from distributed.comm import connect

    comm = await asyncio.wait_for(connect(url, timeout=CONNECT_TIMEOUT), 2 * CONNECT_TIMEOUT)
    await comm.close()


def become_worker() -> None:
    """Initialise a process of a pool, which ends when its parent dies.

    It sends logs and events to Prefect's server directly. By default Prefect sends them to the
    parent through a queue; a killed worker may hold the queue's lock, and the parent would hang.
    """
    send_events(NO_EVENTS not in os.environ)
    set_api_log_sink(None)
    parent = multiprocessing.parent_process()
    assert parent is not None  # a process of a pool has one

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _set_ray_variables() -> None:
    """Set the environment variables that Ray reads on import, unless they are set already."""
    variables = {
        "RAY_USAGE_STATS_ENABLED": "0",
        # Suppresses a warning at every fork.
        "GRPC_VERBOSITY": "ERROR",
        # Ray hides all GPUs from tasks that do not request one.
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
        # Access to Ray allows code execution. By default its token is readable by all users.
        "RAY_AUTH_MODE": "token",
    }
    if (
        "RAY_AUTH_TOKEN_PATH" not in os.environ
        and not Path("~/.ray/auth_token").expanduser().exists()
    ):
        variables["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    for name, value in variables.items():
        os.environ.setdefault(name, value)


@contextmanager
def _ray(url: str) -> Iterator[TaskRunner[Any]]:
    import ray
    from prefect_ray import RayTaskRunner
    from prefect_ray.context import remote_options

    with ExitStack() as stack:
        variables = {NO_EVENTS: os.environ[NO_EVENTS]} if NO_EVENTS in os.environ else {}
        connect = partial(
            ray.init,
            url,
            namespace="slgaussian",
            runtime_env={"env_vars": variables},
            log_to_driver=False,
            logging_level=logging.CRITICAL,
        )
        before = signal.getsignal(signal.SIGTERM)  # Ray replaces the handler
        try:
            # Ray's workers import from the client's working directory first: use an empty one.
            with (
                tempfile.TemporaryDirectory() as empty,
                chdir(empty),
                warnings.catch_warnings(action="ignore"),
            ):
                try:
                    connect()
                except ConnectionAbortedError:
                    # The server process that Ray forks for a client may crash in gRPC's threads.
                    connect()
        except Exception as error:  # Ray's own, and any
            raise InputError(
                f"runner: the Ray cluster at {url} refuses us ({last_line(str(error))}); if it "
                "wants a token, give it in RAY_AUTH_TOKEN"
            ) from error
        finally:
            signal.signal(signal.SIGTERM, before)
        stack.callback(ray.shutdown)
        # flows.runners.batches retries scenes whose worker died.
        stack.enter_context(remote_options(max_retries=0))
        yield stack.enter_context(RayTaskRunner())


def last_line(text: str) -> str:
    """Return the line of an error message that states its cause.

    The last one, as a traceback of another process may come first; of gRPC's, which end with a
    bracket (https://grpc.github.io/grpc/python/grpc.html#grpc.RpcError), the line of details.
    """
    lines = [line.strip() for line in text.strip().splitlines()] or ["unknown"]
    return next((line for line in lines if line.startswith("details = ")), lines[-1])
