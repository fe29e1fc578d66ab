"""Cost of a command and its child processes, from the counters in /proc."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

CLI = (sys.executable, "-c", "from flows.cli.app import main; main()")
"""Command line of this checkout."""

EVERY = 0.2
"""Sampling interval of the memory, seconds."""


@dataclass
class Cost:
    """Seconds; peak RSS of all processes together and of the largest single one, megabytes."""

    wall: float = 0.0
    cpu: float = 0.0
    peak: float = 0.0
    largest: float = 0.0
    output: list[str] = field(default_factory=list)


def costing(words: Sequence[object], status: Sequence[int] = (0,), **options: object) -> Cost:
    """Run a command and return its cost; SystemExit with its output if it fails."""
    cost = Cost()
    before, start = os.times(), time.perf_counter()
    run = subprocess.Popen(
        list(map(str, words)),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )
    watch = threading.Thread(target=_watch, args=(run, cost), daemon=True)
    watch.start()
    cost.output = run.communicate()[0].splitlines()
    watch.join()
    cost.wall = time.perf_counter() - start
    after = os.times()
    cost.cpu = sum(after[2:4]) - sum(before[2:4])
    if run.returncode not in status:
        raise SystemExit("\n".join([*cost.output[-20:], f"status {run.returncode}: {words}"]))
    return cost


def family(pid: int) -> list[int]:
    """Return the ids of a process and its living descendants."""
    pids = [pid]
    for process in pids:
        try:
            for task in Path(f"/proc/{process}/task").iterdir():
                pids += map(int, (task / "children").read_text().split())
        except OSError:
            continue
    return pids


def _watch(run: subprocess.Popen, cost: Cost) -> None:
    page = os.sysconf("SC_PAGE_SIZE") / 2**20
    while run.poll() is None:
        sizes = [0.0]
        for pid in family(run.pid):
            try:
                sizes.append(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * page)
            except OSError:
                continue
        cost.peak, cost.largest = max(cost.peak, sum(sizes)), max(cost.largest, *sizes)
        time.sleep(EVERY)
