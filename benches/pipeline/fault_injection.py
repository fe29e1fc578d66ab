"""A run that everything happens to.

    python -m benches.pipeline.fault_injection WORK [--scenes 200] [--kills 10]

Small made-up rooms on disk; one in twenty is damaged, each in another way. A run of the whole ones
on threads, left alone, gives the store to compare with. Then all of them go on two processes, of
which one at random is killed (SIGKILL) again and again, and once the whole run, which is started
again. What it leaves is compared file by file with the other store.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.machine import measured
from benches.common.process_cost import CLI, costing, family
from benches.common.small_rooms import write_rooms
from slgaussian.storage.records import Record, Records
from slgaussian.storage.store import ArtifactStore

SHARE = 20
"""One in so many scenes is damaged."""

BETWEEN = (2.0, 8.0)
"""Seconds between two kills, at random."""


def _cut(room: Path) -> None:
    image = room / "view_00.png"
    image.write_bytes(image.read_bytes()[: image.stat().st_size // 2])


def _frames(room: Path, change: Callable[[list[dict]], None]) -> None:
    cameras = json.loads((room / "transforms.json").read_text())
    change(cameras["frames"])
    (room / "transforms.json").write_text(json.dumps(cameras))


DAMAGES: dict[str, Callable[[Path], None]] = {
    "a photograph cut short": _cut,
    "a photograph gone": lambda room: (room / "view_02.png").unlink(),
    "a photograph that is text": lambda room: (room / "view_02.png").write_text("no picture"),
    "an empty photograph": lambda room: (room / "view_00.png").write_bytes(b""),
    "cameras cut short": lambda room: (room / "transforms.json").write_text('{"frames": ['),
    "a pose of NaN": lambda room: _frames(
        room, lambda frames: frames[0].update(transform_matrix=[[float("nan")] * 4] * 4)
    ),
    "a pose that is no rotation": lambda room: _frames(
        room, lambda frames: frames[2].update(transform_matrix=[[2.0] * 4] * 4)
    ),
    "a focal length of 0": lambda room: _frames(room, lambda frames: frames[0].update(fl_x=0)),
    "a view without its camera": lambda room: _frames(room, lambda frames: frames.pop(0)),
    "context views of one place": lambda room: _frames(
        room, lambda frames: frames[2].update(transform_matrix=frames[0]["transform_matrix"])
    ),
}


def rooms(work: Path, scenes: int) -> tuple[Path, Path, dict[str, str]]:
    """Files for `slgaussian run` with all rooms and with the whole ones; what ails the others."""
    whole = write_rooms(work / "rooms", scenes)
    header, *entries = whole.read_text().split("[[scenes]]\n")
    ailing = {}
    for number, (what, damage) in zip(
        range(SHARE // 2, scenes, SHARE), cycle(DAMAGES.items()), strict=False
    ):
        name = f"room_{number:04d}"
        ailing[name] = what
        if not (work / "rooms" / name / "damaged").exists():
            damage(work / "rooms" / name)
            (work / "rooms" / name / "damaged").touch()
    kept = [entry for entry in entries if entry.split('"')[1] not in ailing]
    left = work / "rooms" / "whole.toml"
    left.write_text("[[scenes]]\n".join([header, *kept]))
    return whole, left, ailing


def workers_of(pid: int) -> list[int]:
    """The processes of the pool that a run has started."""
    found = []
    for own in family(pid)[1:]:
        try:
            words = Path(f"/proc/{own}/cmdline").read_bytes()
        except OSError:
            continue
        if b"multiprocessing.spawn" in words or b"spawn_main" in words:
            found.append(own)
    return found


def disturbed(command: Sequence[object], log: Path, kills: int, dice: random.Random) -> list[str]:
    """Run a command to its end while its workers are killed, and once itself; what was done."""
    done: list[str] = []
    start = time.perf_counter()
    while True:
        with log.open("ab") as out:
            run = subprocess.Popen(list(map(str, command)), stdout=out, stderr=out)
        while run.poll() is None:
            due = time.perf_counter() + dice.uniform(*BETWEEN)
            while run.poll() is None and time.perf_counter() < due:
                time.sleep(0.05)
            at_work = workers_of(run.pid)
            if len(done) > kills or not at_work or run.poll() is not None:
                continue
            # In the middle, the run itself.
            whole = len(done) == kills // 2
            os.kill(run.pid if whole else dice.choice(at_work), signal.SIGKILL)
            done.append("the run" if whole else "a worker")
            print(f"{time.perf_counter() - start:6.1f} s  killed {done[-1]}", flush=True)
        if run.returncode in (0, 1):
            return done
        if run.returncode != -signal.SIGKILL:
            raise SystemExit(f"status {run.returncode}; see {log}")


def records_of(store: ArtifactStore) -> dict[str, Record]:
    return {r.file.uri: r for some in Records(store).all() for r in some if r.stage != "report"}


def differences(first: ArtifactStore, second: ArtifactStore, whole: int) -> list[str]:
    """What the second store has not as the first has it, and what it has left lying about."""
    wanted, found = records_of(first), records_of(second)
    wrong = [f"not there: {uri}" for uri in wanted.keys() - found.keys()]
    for uri in wanted.keys() & found.keys():
        for path in wanted[uri].named:
            if first.read(path) != second.read(path):
                wrong.append(f"other bytes: {path}")
    names = {path for record in found.values() for path in record.named}
    for file in Path(second.path).rglob("*"):
        own = file.relative_to(second.path).as_posix()
        if not file.is_file() or own.startswith((".prefect/", "keys/", "report/", "digests/")):
            continue
        if own not in names:
            wrong.append(f"nothing names it: {own}")
    print(f"{len(wanted)} records of {whole} whole scenes, {len(found)} of all")
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for photographs and stores")
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    work = asked.work.resolve()
    for left in ("undisturbed", "disturbed", "out", "out-disturbed"):
        shutil.rmtree(work / left, ignore_errors=True)
    everything, whole, ailing = rooms(work, asked.scenes)
    words = ["run", whole, "-o", work / "out", "--store", work / "undisturbed"]
    cost = costing([*CLI, *words])
    print(f"undisturbed, threads: {cost.wall:.0f} s")
    words = ["run", everything, "-o", work / "out-disturbed", "--store", work / "disturbed"]
    command = [*CLI, *words, "--runner", "processes", "--workers", 2]
    start = time.perf_counter()
    log = work / "disturbed.log"
    log.unlink(missing_ok=True)
    done = disturbed(command, log, asked.kills, random.Random(asked.seed))
    print(f"disturbed, processes: {time.perf_counter() - start:.0f} s, {len(done)} kills")
    failures = pq.read_table(work / "out-disturbed" / "failures.parquet").to_pylist()
    for failure in failures:
        what = ailing.get(failure["scene"], "NOT DAMAGED")
        print(f"{failure['scene']}, {what}: at {failure['stage']}: {failure['reason']}")
    wrong = differences(
        ArtifactStore(work / "undisturbed"), ArtifactStore(work / "disturbed"), asked.scenes
    )
    named = sorted(failure["scene"] for failure in failures)
    if named != sorted(ailing):
        wrong.append(f"left out were {named}, damaged {sorted(ailing)}")
    print("\n".join(wrong) or f"both stores are equal, byte for byte; {measured()}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
