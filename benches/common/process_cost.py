"""What a command costs: all of its processes, from the kernel's own counts in /proc."""

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
"""The command line of the sources that this runs in."""

EVERY = 0.2
"""Seconds between two looks at the memory."""


@dataclass
class Cost:
    """Seconds; megabytes of all processes together, and the most of a single one (RSS)."""

    wall: float = 0.0
    cpu: float = 0.0
    peak: float = 0.0
    largest: float = 0.0
    output: list[str] = field(default_factory=list)


def costing(words: Sequence[object], status: Sequence[int] = (0,), **options: object) -> Cost:
    """Run a command to its end and say what it cost; SystemExit with its words if it fails."""
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
    """A process and all that it started, and those, as far as they are there."""
    found = [pid]
    for own in found:
        try:
            for task in Path(f"/proc/{own}/task").iterdir():
                found += map(int, (task / "children").read_text().split())
        except OSError:
            continue
    return found


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
