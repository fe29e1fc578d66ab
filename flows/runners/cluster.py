"""A Dask or Ray cluster on this machine that cannot outlive the program that started it.

Both leave processes or folders behind when the program that runs them is killed. So a process of
its own does, which holds the reading end of a pipe whose writing end only our program has: however
that dies, ``kill -9`` included, the kernel closes the pipe and the process takes its cluster down.
All of it listens on loopback only.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from flows.runners import child
from flows.runners.server import LOOPBACK
from slgaussian.errors import InputError


@contextmanager
def local_cluster(kind: str, workers: int) -> Iterator[str]:
    """A cluster for the time of the block: its address.

    Parameters
    ----------
    kind : str
        ``dask`` or ``ray``.
    workers : int
        How many processes it has to work, each at one task at a time.

    Raises
    ------
    InputError
        If it does not start.
    """
    process = child.begin(
        "flows.runners.cluster",
        kind,
        str(workers),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run, which then stops the cluster
    )
    assert process.stdin is not None and process.stdout is not None  # they are pipes
    try:
        told = json.loads(process.stdout.readline() or '{"error": "its process ended"}')
        if "error" in told:
            raise InputError(f"runner: {kind} cannot start here ({told['error']})")
        yield told["address"]
    finally:
        process.stdin.close()
        process.wait()
        process.stdout.close()


def hold(kind: str, workers: int) -> None:
    """The process: tell the address on standard output, and stay until standard input ends."""
    # None of the processes of the cluster must keep the pipe open, or write to it.
    with os.fdopen(os.dup(1), "w") as told:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        try:
            with {"dask": _dask, "ray": _ray}[kind](workers) as address:
                told.write(json.dumps({"address": address}) + "\n")
                told.flush()
                sys.stdin.buffer.read()
        except Exception as error:  # they raise whatever they like
            told.write(json.dumps({"error": last_line(str(error))}) + "\n")


def last_line(text: str) -> str:
    """What went wrong, of an error that brings another process's traceback along."""
    return (text.strip().splitlines() or ["unknown"])[-1].strip()


@contextmanager
def _dask(workers: int) -> Iterator[str]:
    import dask
    from distributed import LocalCluster

    # Whose worker died is tried again by us, chain by chain.
    settings = {"distributed.scheduler.allowed-failures": 0}
    with (
        tempfile.TemporaryDirectory(prefix="slg-dask-", ignore_cleanup_errors=True) as folder,
        dask.config.set({**settings, "temporary-directory": folder}),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            # As of threads and processes: a share of the memory would end what needs more.
            memory_limit=0,
        ) as cluster,
    ):
        yield cluster.scheduler_address


@contextmanager
def _ray(workers: int) -> Iterator[str]:
    import ray

    # Its path is short, as sockets are in it.
    with tempfile.TemporaryDirectory(prefix="slg-ray-", ignore_cleanup_errors=True) as folder:
        context: Any = ray.init(
            "local",
            num_cpus=workers,
            include_dashboard=False,
            _node_ip_address=LOOPBACK,
            _temp_dir=folder,
            # Nothing large goes through it, and it would take a third of the memory.
            object_store_memory=100 * 2**20,
            logging_level=logging.CRITICAL,
        )
        yield context.address_info["gcs_address"]
        ray.shutdown()


if __name__ == "__main__":
    hold(sys.argv[1], int(sys.argv[2]))
