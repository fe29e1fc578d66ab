"""Who does the work of a flow: threads, processes, or the workers of a Dask or Ray cluster."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from importlib import import_module
from multiprocessing.connection import wait
from types import ModuleType
from urllib.parse import urlsplit

from prefect.task_runners import ProcessPoolTaskRunner, TaskRunner, ThreadPoolTaskRunner

from flows.server import LOOPBACK
from slgaussian.errors import InputError
from slgaussian.store import ArtifactStore

CONNECT = 10.0
"""Seconds to wait for a cluster that is said to run."""


def task_runner(runner: str, workers: int, store: ArtifactStore) -> TaskRunner:
    """The task runner of a name, not started.

    Parameters
    ----------
    runner : str
        As :data:`flows.settings.Runner` has it.
    workers : int
        How many tasks are run at the same time.
    store : ArtifactStore
        The one that the tasks use.

    Raises
    ------
    InputError
        If the package of the runner is not installed, its cluster does not answer, or its workers
        could not reach the store or the Prefect server.
    """
    kind, _, address = runner.partition("://")
    if kind == "threads":
        return ThreadPoolTaskRunner(max_workers=workers)
    if store.near and not store.local:
        raise InputError(
            f"runner: found {runner!r}, whose workers cannot see the store {store.root}, which is "
            "in the memory of this process; choose a folder or a bucket with --store, or the "
            "runner threads"
        )
    if kind == "processes":
        return ProcessPoolTaskRunner(max_workers=workers, initializer=leave_with_parent)
    if address:
        _check_reachable(runner)
    return {"dask": _dask, "ray": _ray}[kind](address, workers)


def _dask(address: str, workers: int) -> TaskRunner:
    runner = _imported("prefect_dask", "dask").DaskTaskRunner
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    if address:
        from distributed import Client

        url = f"tcp://{address}"
        try:
            Client(url, timeout=CONNECT, set_as_default=False).close()
        except (OSError, ValueError) as error:
            raise InputError(_nobody("Dask scheduler", f"dask://{address}", error)) from error
        return runner(address=url)
    return runner(
        cluster_kwargs={
            "n_workers": workers,
            "threads_per_worker": 1,
            "processes": True,
            "host": LOOPBACK,
            "dashboard_address": None,
            # As of threads and processes: a share of the memory would end what needs more.
            "memory_limit": 0,
        }
    )


def _ray(address: str, workers: int) -> TaskRunner:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    runner = _imported("prefect_ray.task_runners", "ray").RayTaskRunner
    quiet = {"log_to_driver": False, "logging_level": "CRITICAL"}
    if address:
        import socket

        place = urlsplit(f"ray://{address}")
        try:
            # Ray itself tries for half a minute.
            socket.create_connection((place.hostname, place.port or 10001), CONNECT).close()
        except OSError as error:
            raise InputError(_nobody("Ray head", f"ray://{address}", error)) from error
        variables = {k: v for k, v in os.environ.items() if k.startswith("PREFECT_")}
        own = {name: value for name, value in variables.items() if name != "PREFECT_HOME"}
        return runner(f"ray://{address}", {**quiet, "runtime_env": {"env_vars": own}})
    return runner(
        init_kwargs={
            **quiet,
            "num_cpus": workers,
            "include_dashboard": False,
            "_node_ip_address": LOOPBACK,
            # Nothing large goes through it, and it would take a third of the memory.
            "object_store_memory": 100 * 2**20,
        }
    )


def leave_with_parent() -> None:
    """End this process of a pool once its parent is gone, however that died."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends it
    parent = multiprocessing.parent_process()

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _imported(module: str, extra: str) -> ModuleType:
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"runner: {extra} is not installed ({error}); install it with "
            f'`pip install "slgaussian[{extra}]"`'
        ) from error


def _check_reachable(runner: str) -> None:
    near = (LOOPBACK, "localhost", "::1")
    server = urlsplit(os.environ.get("PREFECT_API_URL", "")).hostname
    if urlsplit(runner).hostname not in near and server in near:
        raise InputError(
            f"runner: found {runner!r}, whose workers cannot reach the Prefect server of this run, "
            "which is on loopback; start one that they can with `prefect server start --host "
            "0.0.0.0`, and set PREFECT_API_URL to its address"
        )


def _nobody(what: str, url: str, error: Exception) -> str:
    return f"runner: no {what} answers at {url} ({error}); start it, or correct the address"
