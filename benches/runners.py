"""Scenes a minute by runner and workers: ``python benches/runners.py WORK [--scenes 300]``.

Small made-up rooms, photographs on disk, each through all stages of `slgaussian run` from an empty
store. Threads with one worker are the second program: every ratio is to them, in the same run. The
start is that of the Prefect server and of the workers, which a run of hours does not feel, so
scenes a minute are those after it, and a run of a few scenes is taken off for it.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
from machine import machine
from processes import CLI, Cost, costing
from small_scenes import HEIGHT, WIDTH, write_rooms
from tables import Table, count, hundredths

from slgaussian.records import Records
from slgaussian.store import ArtifactStore

RUNNERS = ("threads", "processes", "dask", "ray")
FEW = 4
"""Scenes of the run that is nearly only start."""


def once(work: Path, scenes: int, runner: str, workers: int) -> tuple[Cost, float]:
    """A run from nothing, and the seconds that its stages say they took."""
    shutil.rmtree(work / "store", ignore_errors=True)
    words = ["run", write_rooms(work / f"rooms-{scenes}", scenes), "-o", work / "out"]
    words += ["--store", work / "store", "--runner", runner, "--workers", workers]
    cost = costing([*CLI, *words])
    lost = pq.read_table(work / "out" / "failures.parquet").num_rows
    if lost:
        raise SystemExit(f"{runner}: {lost} scenes were left out")
    records = [r for some in Records(ArtifactStore(work / "store")).all() for r in some]
    return cost, sum(r.ref.meta["seconds"] for r in records if r.stage != "report")


def measured(work: Path, scenes: int, runner: str, workers: int) -> dict:
    start, _ = once(work, FEW, runner, workers)
    cost, stages = once(work, scenes, runner, workers)
    wall = cost.wall - start.wall
    row = {
        "runner": runner,
        "workers": workers,
        "start": start.wall,
        "rate": 60 * (scenes - FEW) / wall,
        "cpu": (cost.cpu - start.cpu) / (scenes - FEW),
        "flow": 1 - stages / (workers * wall),
        "peak": cost.peak,
        "largest": cost.largest,
    }
    print(row, file=sys.stderr, flush=True)
    return row


TABLE = Table(
    "Scenes a minute",
    "{scenes} made-up rooms of three photographs, {height}x{width}, from an empty store to their "
    "report. *start*: a run of {few} scenes, taken off the others. *times*: scenes a minute by "
    "those of one thread. *not in stages*: share of the workers' time in which no stage ran: "
    "passing work on, looking into the store, waiting. Memory: all processes together, the server "
    "among them, and the largest. `python benches/runners.py WORK` on {machine}.",
    {
        "runner": ("runner", str),
        "workers": ("workers", count),
        "start": ("start, s", hundredths),
        "rate": ("scenes a minute", count),
        "times": ("times", hundredths),
        "cpu": ("CPU s a scene", hundredths),
        "flow": ("not in stages", lambda share: f"{100 * share:.0f} %"),
        "peak": ("MB", count),
        "largest": ("largest MB", count),
    },
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for photographs and stores")
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--runners", nargs="+", choices=RUNNERS, default=RUNNERS)
    parser.add_argument("--workers", nargs="+", type=int, default=(1, 2))
    parser.add_argument("-o", "--out", type=Path, help="file for the table")
    asked = parser.parse_args()
    work = asked.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    once(work, FEW, "threads", 1)  # compiles the kernels
    rows = [
        measured(work, asked.scenes, runner, workers)
        for workers in asked.workers
        for runner in asked.runners
    ]
    for row in rows:
        row["times"] = row["rate"] / rows[0]["rate"]
    about = TABLE.about.format(
        scenes=asked.scenes, height=HEIGHT, width=WIDTH, few=FEW, machine=machine()
    )
    text = replace(TABLE, about=about).markdown(rows)
    print(text)
    if asked.out is not None:
        asked.out.write_text(text)


if __name__ == "__main__":
    main()
