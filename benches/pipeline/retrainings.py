"""Retrain while everything happens, and check that nothing was lost or done twice.

    python -m benches.pipeline.retrainings WORK

Made-up rooms arrive, a chunk each, and `slgaussian retrain` runs again and again: with new
rooms and none, a damaged chunk, a run that is killed (SIGKILL), one that overruns into the next, a
room that is changed and one that is withdrawn, and a clock that is put back and forward (with
`pip install libfaketime`). In the end its tables are compared with those of one `supervise` of what
is there then, in a store of its own. Prints a table of the runs.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.machine import measured
from benches.common.process_cost import CLI
from flows.retraining import STATUS
from slgaussian import datasets
from slgaussian.datasets import re10k
from slgaussian.semantic.versions import Versions

CONFIG = """\
chunks = "chunks"
out = "corpus"
models = "models"
store = "store"
withdrawn = "withdrawn.txt"
size = "72x96"
replicas = 1
held_out = 0.4
steps = 20
"""


def room(seed: int, views: int = 6) -> re10k.Clip:
    """A clip of a made-up room."""
    size = {"height": 90, "width": 160}
    made = datasets.load("procedural", seed=seed, objects=4, views=views, baseline=1.0, **size)
    return re10k.clip_of(made)


class Retrainings:
    """A corpus that changes, and what each retraining of it came to."""

    def __init__(self, work: Path) -> None:
        self.work, self.rows = work, []
        (work / "chunks").mkdir(parents=True)
        (work / "retrain.toml").write_text(CONFIG)
        (work / "withdrawn.txt").touch()

    def arrive(self, seeds: Iterable[int], views: int = 6) -> None:
        """Put rooms there, each in a chunk of its own; another number of views changes one."""
        for seed in seeds:
            one = self.work / "one"
            shutil.rmtree(one, ignore_errors=True)
            (made,) = re10k.write(one, [room(seed, views)], 10**9)
            os.replace(one / made, self.work / "chunks" / f"room_{seed}.torch")

    def begin(self, env: Mapping[str, str] | None = None) -> subprocess.Popen:
        """Start a retraining."""
        log = (self.work / "retrainings.log").open("ab")
        command = [*CLI, "retrain", str(self.work / "retrain.toml")]
        return subprocess.Popen(
            command, stdout=log, stderr=log, env={**os.environ, **(env or {})},
            start_new_session=True,
        )  # fmt: skip

    def run(self, what: str, expected: Iterable[str], env: Mapping[str, str] | None = None) -> None:
        """Retrain, to the end."""
        start = time.perf_counter()
        self.over(what, expected, self.begin(env), start)

    def over(
        self, what: str, expected: Iterable[str], process: subprocess.Popen, start: float
    ) -> None:
        """Wait for a retraining, and put it down."""
        status = process.wait()
        came = {code: name for name, code in STATUS.items()}.get(status, f"signal {-status}")
        seconds = time.perf_counter() - start
        self.rows.append((what, came, status, seconds, came in expected))
        print(f"{what}: {came}, {seconds:.0f} s", flush=True)

    def records(self) -> list[dict]:
        """Read the records of all retrainings, in order."""
        files = sorted((self.work / "corpus" / "history").glob("*.json"))
        return [json.loads(file.read_text()) for file in files]


def clock(work: Path, offset: str) -> dict[str, str] | None:
    """The environment of a program whose clock is off, if that can be had."""
    found = importlib.util.find_spec("libfaketime")
    if found is None or found.origin is None:
        return None
    (library,) = Path(found.origin).parent.rglob("libfaketime.so.1")
    return {"LD_PRELOAD": str(library), "FAKETIME": offset, "DONT_FAKE_MONOTONIC": "1"}


def wrongs(retrainings: Retrainings, there: set[str], gone: str, changed: str) -> list[str]:
    """What was lost, done twice, or is still there."""
    work, found = retrainings.work, []
    arrived = Counter(
        clip for record in retrainings.records() if "changes" in record
        for clip in record["changes"]["arrived"]["first"]
    )  # fmt: skip
    for clip in sorted(there | {gone}):
        if arrived[clip] != 1:
            found.append(f"{clip} arrived {arrived[clip]} times")
    told = [record["changes"] for record in retrainings.records() if "changes" in record]
    for kind, clip in (("withdrawn", gone), ("changed", changed)):
        count = sum(clip in one[kind]["first"] for one in told)
        if count != 1:
            found.append(f"{clip} was {kind} {count} times")
    again = [*CLI, "supervise", work / "chunks", "-o", work / "again", "--store", work / "other"]
    again += ["--size", "72x96", "--set", "replicas=1", "--set", f"withdrawn={work}/withdrawn.txt"]
    subprocess.run(list(map(str, again)), check=False, capture_output=True)
    for name in ("views", "pairs", "lessons"):
        ours, theirs = (
            pq.read_table(work / folder / f"{name}.parquet") for folder in ("corpus", "again")
        )
        if not ours.equals(theirs):
            found.append(f"{name}.parquet differs from that of a single run")
        if set(ours["clip"].to_pylist()) - there:
            found.append(f"{name}.parquet has clips that are not there")
    versions = Versions(work / "models")
    last = versions.all()[-1]
    if gone in {clip for table in versions.learnt(last) for clip in table["clip"].to_pylist()}:
        found.append(f"version {last.number} has learnt {gone}")
    left = [str(file) for file in work.rglob("*.tmp") if ".prefect" not in file.parts]
    return found + [f"left behind: {file}" for file in left]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="an empty folder")
    work = parser.parse_args().work.resolve()
    retrainings = Retrainings(work)
    judged = ("refused", "promoted", "regressed")

    retrainings.arrive(range(4))
    retrainings.run("four rooms arrive", judged)
    retrainings.run("nothing", ["nothing new"])
    retrainings.arrive([4, 5])
    (work / "chunks" / "broken.torch").write_bytes(b"no chunk")
    retrainings.run("two arrive, and a damaged chunk", judged)

    retrainings.arrive([6])
    start, process = time.perf_counter(), retrainings.begin()
    log = work / "corpus" / "log.jsonl"
    while process.poll() is None and not ("room_6" in log.read_text() if log.exists() else False):
        time.sleep(0.1)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    retrainings.over("one arrives; killed", ["signal 9"], process, start)
    retrainings.run("the next one", judged)

    retrainings.arrive([7])
    start, process = time.perf_counter(), retrainings.begin()
    while not (work / "corpus" / "history" / "000006.json").exists():
        time.sleep(0.1)
    retrainings.run("begun while the one before is on", ["busy"])
    retrainings.over("one arrives; overruns into the next", judged, process, start)

    versions = Versions(work / "models")
    versions.use(versions.all()[-1], "the bench", "so that something is in use")
    learnt = versions.learnt(versions.all()[-1])[-1]["clip"].to_pylist()
    gone, changed = learnt[0], learnt[1]
    (work / "withdrawn.txt").write_text(f"{gone}\n")
    retrainings.arrive([int(changed.rpartition("_")[2])], views=7)
    retrainings.run("one withdrawn, one changed", judged)
    back = clock(work, "-25h")
    if back is not None:
        retrainings.arrive([8])
        retrainings.run("one arrives; the clock a day back", judged, back)
        retrainings.run("nothing; the clock 40 days ahead", ["nothing new"], clock(work, "+40d"))

    rooms = range(9 if back is not None else 8)
    there = {room(seed).key for seed in rooms} - {gone}
    known = set(pq.read_table(work / "corpus" / "views.parquet")["clip"].to_pylist())
    wrong = wrongs(retrainings, there & known, gone, changed)
    if there - known:
        wrong.append(f"lost: {sorted(there - known)}")
    print(f"\n{measured()}\n")
    print("| retraining | came to | status | s | as expected |\n|---|---|--:|--:|---|")
    for what, came, status, seconds, good in retrainings.rows:
        print(f"| {what} | {came} | {status} | {seconds:.0f} | {'yes' if good else 'NO'} |")
    print("\n".join(wrong) or "\nNothing lost, nothing twice, nothing withdrawn left.")
    sys.exit(bool(wrong) or not all(row[-1] for row in retrainings.rows))


if __name__ == "__main__":
    main()
