"""What it costs to make a corpus ready: ``python benches/corpus.py WALK [--rooms 40] [-o FILE]``.

WALK is a nerfstudio folder of a walk with a camera. Every stage runs in a process of its own on one
worker, the stages before it found in the store, so that its time and memory are its own. Two
corpora: made-up rooms of 12 views in small chunks, and a chunk as large as the published ones, of
the walk ten times over.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from machine import machine
from tables import Table, count, hundredths

COPIES = 10
"""Of the walk, which make about 100 MB."""

CLIPS = 67_000
VIEWS = 150
PICKED = 2
"""Clips of RealEstate10K, views of one (500 GB at 45 kB a view) and samples chosen of each."""

MACHINES = (1, 10, 100)


def child(chunks: str, store: str, out: str, stages: list[str], workers: int) -> dict:
    """Run stages and say what they cost this process."""
    from flows.corpus_settings import make_corpus_settings
    from flows.environment import orchestration
    from slgaussian.store import ArtifactStore

    settings = make_corpus_settings({"chunks": chunks, "out": out, "workers": workers}, "bench")
    begun = time.perf_counter()
    with orchestration(ArtifactStore(store)) as ready:
        from flows import corpus

        ready()
        start_up = time.perf_counter() - begun
        wall, cpu = time.perf_counter(), time.process_time()
        before = peak_mb()
        made = corpus.prepare(settings, ArtifactStore(store), stages)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    last = [refs[stages[-1]].meta for refs in made.refs.values()]
    times: dict[str, float] = {}
    for meta in last:
        for part, seconds in meta.get("times", {}).items():
            times[part] = times.get(part, 0) + seconds
    return {
        "wall": wall,
        "cpu": cpu,
        "start_up": start_up,
        "work": sum(meta["seconds"] for meta in last),
        "all_work": sum(
            refs[stage].meta["seconds"] for refs in made.refs.values() for stage in stages
        ),
        "peak": peak_mb(),
        "idle": before,
        "items": sum(meta.get("views", meta.get("samples")) for meta in last),
        "times": times,
        "failures": len(made.failures),
    }


def peak_mb() -> float:
    """Most memory that this process ever held, megabytes.

    Not ``getrusage``, whose peak a process has from the one that started it.
    """
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def apart(*words: object) -> dict:
    """:func:`child` in a process of its own."""
    run = [sys.executable, __file__, "--child", json.dumps(words)]
    done = subprocess.run(run, stdout=subprocess.PIPE, check=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def packed(work: Path, walk: Path, rooms: int) -> tuple[dict[str, Path], float]:
    """The two corpora, made unless they are there, and seconds to pack one room."""
    from flows.corpus_settings import PackSettings
    from flows.packing import pack
    from slgaussian.datasets import nerfstudio, re10k

    small = PackSettings(chunk_mb=10)
    folders = {"rooms": work / "rooms", "walk": work / "walk"}
    if not folders["rooms"].exists():
        pack([f"procedural:0-{rooms - 1}"], folders["rooms"], small)
    if not folders["walk"].exists():
        clip = re10k.clip_of(nerfstudio.read(walk))
        copies = (replace(clip, key=f"{clip.key}_{number}") for number in range(COPIES))
        re10k.write(folders["walk"], copies, 2 * re10k.CHUNK_BYTES)
    with tempfile.TemporaryDirectory() as spare:
        pack(["procedural:9000"], Path(spare), small)
        start = time.process_time()
        pack(["procedural:9001-9002"], Path(spare), small)
        return folders, (time.process_time() - start) / 2


def measured(folder: Path, work: Path) -> tuple[list[dict], dict, dict, float]:
    """Rows by stage, a whole run on two workers, the same again, bytes of the store a sample."""
    from flows.corpus import SUPERVISE

    rows = []
    store, out = work / f"store-{folder.name}", work / f"out-{folder.name}"
    for index, stage in enumerate(SUPERVISE):
        found = apart(str(folder), str(store), str(out), SUPERVISE[: index + 1], 1)
        rows.append({"corpus": folder.name, "stage": stage, **found})
        print(rows[-1], file=sys.stderr, flush=True)
    size = sum(
        file.stat().st_size
        for spec in ("gaussians", "lesson", "sheet", "lessons", "pairs", "predictions")
        for file in (store / spec).rglob("*.*")
    )
    # Equal clips share artifacts, so only rooms say what a sample takes.
    both = work / f"store2-{folder.name}"
    whole = apart(str(folder), str(both), str(out), SUPERVISE, 2)
    again = apart(str(folder), str(both), str(out), SUPERVISE, 2)
    return rows, whole, again, size / rows[-1]["items"]


def share(value: float) -> str:
    return f"{100 * value:.1f} %"


STAGES = Table(
    "Stages",
    "CPU seconds of the whole process; a minute of one core does so many views or samples. "
    "*flow* is the share of the time in which the flow ran and no stage worked. Memory is the "
    "peak of the process, of which an idle one, everything imported, has the *idle* part.",
    {
        "corpus": ("corpus", str),
        "stage": ("stage", str),
        "items": ("done", count),
        "what": ("of", str),
        "cpu": ("CPU s", hundredths),
        "rate": ("a minute", count),
        "flow": ("flow", share),
        "peak": ("peak MB", count),
        "idle": ("idle MB", count),
    },
)

RUNS = Table(
    "Whole runs",
    "All four stages on two workers, and the same command again. *start* is that of the Prefect "
    "server, once a command.",
    {
        "corpus": ("corpus", str),
        "items": ("lessons", count),
        "wall": ("s", hundredths),
        "cpu": ("CPU s", hundredths),
        "again": ("again, s", hundredths),
        "start_up": ("start, s", hundredths),
        "flow": ("flow, one worker", share),
    },
)

PAPER = Table(
    f"{CLIPS:,} clips on paper",
    f"From the rates of the walk above: {VIEWS} views a clip, {PICKED} samples of each "
    f"(`--most {PICKED}`), both cores of each machine busy, chunks shared out evenly.",
    {
        "machines": ("machines", count),
        "views": ("views, hours", hundredths),
        "predictions": ("Gaussians, hours", hundredths),
        "lessons": ("lessons, hours", hundredths),
        "days": ("all, days", hundredths),
        "disk": ("store, GB in all", count),
        "memory": ("GB a machine", hundredths),
    },
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("walk", type=Path, nargs="?")
    parser.add_argument("--rooms", type=int, default=40)
    parser.add_argument("--work", type=Path, help="folder for chunks and stores, kept")
    parser.add_argument("-o", "--out", type=Path, help="Markdown file")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        print(json.dumps(child(*json.loads(given.child))))
        return
    work = given.work or Path(tempfile.mkdtemp(prefix="slg-corpus-"))
    folders, room = packed(work, given.walk, given.rooms)
    stages, runs, sizes = [], [], {}
    for name, folder in folders.items():
        rows, whole, again, sizes[name] = measured(folder, work)
        for row in rows:
            row["what"] = "views" if row["stage"] == "views" else "samples"
            row["rate"] = 60 * row["items"] / row["cpu"]
            row["flow"] = 1 - row["work"] / row["wall"]
        stages += rows
        work_seconds = sum(row["work"] for row in rows)
        flow = 1 - work_seconds / sum(row["wall"] for row in rows)
        runs.append({"corpus": name, **whole, "again": again["wall"], "flow": flow})
    cost = {row["stage"]: row["cpu"] / row["items"] for row in stages if row["corpus"] == "walk"}
    peak = max(row["peak"] for row in stages)
    hours = {
        "views": CLIPS * VIEWS * cost["views"] / 7200,
        "predictions": CLIPS * PICKED * cost["predictions"] / 7200,
        "lessons": CLIPS * PICKED * cost["lessons"] / 7200,
    }
    paper = [
        {
            "machines": n,
            **{stage: value / n for stage, value in hours.items()},
            "days": sum(hours.values()) / 24 / n,
            "disk": CLIPS * PICKED * sizes["rooms"] / 1e9,
            "memory": 2 * peak / 1024,
        }
        for n in MACHINES
    ]
    parts = stages[-1]["times"]
    told = ", ".join(f"{part} {s / sum(parts.values()):.0%}" for part, s in parts.items())
    pages = [
        f"Made by `python benches/corpus.py WALK --rooms {given.rooms}` on {machine()}.\n",
        f"Packing a room of 12 views takes {room:.1f} CPU s. Lessons of the walk: {told}; a sample "
        f"of a room takes {sizes['rooms'] / 1e6:.1f} MB of the store.\n",
        STAGES.markdown(stages),
        RUNS.markdown(runs),
        PAPER.markdown(paper),
    ]
    text = "\n".join(pages)
    print(text)
    if given.out:
        given.out.write_text(text)


if __name__ == "__main__":
    main()
