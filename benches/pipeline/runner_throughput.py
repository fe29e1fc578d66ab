"""Scenes a minute by runner and workers.

    python -m benches.pipeline.runner_throughput WORK [--scenes 300]

Small made-up rooms, photographs on disk, each through all stages of `slgaussian run` from an empty
store. Threads with one worker are the second program: every ratio is to them, in the same run. The
start, of the Prefect server and of the workers, is not felt by a run of hours: scenes a minute are
those from the moment when the workers are there, as the run's own log has it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from datetime import datetime
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.pages import publish
from benches.common.process_cost import CLI, costing
from benches.common.small_rooms import HEIGHT, WIDTH, write_rooms

RUNNERS = ("threads", "processes")
FEW = 4
"""Scenes of a run before, in which kernels are compiled."""


def once(work: Path, scenes: int, runner: str, workers: int) -> dict:
    """A run from nothing."""
    shutil.rmtree(work / "store", ignore_errors=True)
    words = ["run", write_rooms(work / f"rooms-{scenes}", scenes), "-o", work / "out"]
    words += ["--store", work / "store", "--runner", runner, "--workers", workers]
    # A core a worker: one worker would use all that it is let.
    cores = sorted(os.sched_getaffinity(0))[:workers]
    cost = costing([*CLI, *words], preexec_fn=lambda: os.sched_setaffinity(0, cores))
    lost = pq.read_table(work / "out" / "failures.parquet").num_rows
    if lost:
        raise SystemExit(f"{runner}: {lost} scenes were left out")
    events = [json.loads(line) for line in (work / "out" / "log.jsonl").open()]
    begun = moment(next(event for event in events if event["event"] == "began"))
    stages = [e for e in events if e["event"] == "finished" and e["stage"] != "report"]
    took = moment([event for event in events if event["event"] == "done"][scenes - 1]) - begun
    row = {
        "runner": runner,
        "workers": workers,
        "scenes": scenes,
        "start": cost.wall - took,
        "rate": 60 * scenes / took,
        "cpu": cost.cpu / scenes,
        "flow": 1 - sum(event["seconds"] for event in stages) / (workers * took),
        "peak": cost.peak,
        "largest": cost.largest,
    }
    print(row, file=sys.stderr, flush=True)
    return row


def moment(event: dict) -> float:
    return datetime.fromisoformat(event["time"]).timestamp()


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
        once(work, asked.scenes, runner, workers)
        for workers in asked.workers
        for runner in asked.runners
    ]
    for row in rows:
        row["times"] = row["rate"] / rows[0]["rate"]
    size = {"scenes": asked.scenes, "height": HEIGHT, "width": WIDTH}
    publish("pipeline/runners.md.j2", asked.out, rows=rows, **size)


if __name__ == "__main__":
    main()
