"""What it costs to learn from a corpus.

    python -m benches.pipeline.corpus_cost WALK [--rooms 200] [-o FILE]

WALK is a nerfstudio folder of a walk with a camera. Every stage runs in a process of its own on one
worker, the stages before it found in the store, so that its time and memory are its own; then all
of `slgaussian retrain` in one process on two. Two corpora: *road*, made-up
rooms of 12 views and the walk in chunks of 10 MB, and *large*, one chunk as large as the published
ones, of the walk ten times over, which is not learnt from.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq

from benches.common.pages import publish
from slgaussian.benchmark.resident_memory import held
from slgaussian.semantic.versions import Versions

COPIES = 10
"""Of the walk, which make about 100 MB."""

CLIPS = 67_000
VIEWS = 150
PICKED = 2
"""Clips of RealEstate10K, views of one (500 GB at 45 kB a view) and samples chosen of each."""

MACHINES = (1, 10, 100)


def child(chunks: str, store: str, out: str, stages: list[str], workers: int) -> dict:
    """Run stages and say what they cost this process."""
    from flows.config import CorpusSettings
    from flows.read_config import make_settings
    from flows.runners.environment import orchestration
    from slgaussian.storage.store import ArtifactStore

    given = {"chunks": chunks, "out": out, "store": store, "workers": workers}
    settings = make_settings(given, "bench", CorpusSettings)
    begun = time.perf_counter()
    with orchestration(ArtifactStore(store)) as ready:
        from benches.pipeline.chunk_stages import take_chunks

        ready()
        start_up = time.perf_counter() - begun
        wall, cpu = time.perf_counter(), time.process_time()
        before = held("VmHWM") / 2**20
        made = take_chunks(settings, stages[-1])
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    last = [refs[stages[-1]].meta for refs in made.outcome.refs.values()]
    return {
        "wall": wall,
        "cpu": cpu,
        "start_up": start_up,
        "work": sum(meta["seconds"] for meta in last),
        "all_work": sum(
            refs[stage].meta["seconds"] for refs in made.outcome.refs.values() for stage in stages
        ),
        "peak": held("VmHWM") / 2**20,
        "idle": before,
        "items": sum(meta.get("views", meta.get("samples")) for meta in last),
        "failures": len(made.failures),
    }


def learning(chunks: str, store: str, out: str, workers: int) -> dict:
    """Retrain, with whatever of it is not done yet, and say what it cost this process."""
    from flows.read_config import read_retraining
    from flows.runners.environment import orchestration
    from slgaussian.storage.store import ArtifactStore

    places = {"chunks": chunks, "out": out, "models": f"{out}/models", "store": store}
    settings = read_retraining(None, {**places, "workers": workers})
    begun = time.perf_counter()
    with orchestration(ArtifactStore(store)) as ready:
        from flows.retraining import retrain

        ready()
        start_up = time.perf_counter() - begun
        wall, cpu = time.perf_counter(), time.process_time()
        done = retrain(settings)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    record = json.loads(done.record.read_bytes())
    return {
        "wall": wall,
        "cpu": cpu,
        "start_up": start_up,
        "peak": held("VmHWM") / 2**20,
        "items": pq.read_metadata(f"{out}/lessons.parquet").num_rows,
        "message": done.messages[0],
        "counts": Versions(settings.models).all()[-1].facts["counts"],
        "failures": len(record["left out"]),
    }


def apart(what: Callable[..., dict], *words: object) -> dict:
    """:func:`child` or :func:`learning` in a process of its own."""
    run = [sys.executable, "-m", __spec__.name, "--child", what.__name__, json.dumps(words)]
    done = subprocess.run(run, stdout=subprocess.PIPE, check=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def packed(work: Path, walk: Path, rooms: int) -> tuple[dict[str, Path], float]:
    """The two corpora, made unless they are there, and seconds to pack one room."""
    from flows.clip_sources import pack
    from flows.config import PackSettings
    from slgaussian.datasets import nerfstudio, re10k

    small = PackSettings(chunk_mb=10)
    folders = {"road": work / "road", "large": work / "large"}
    if not folders["road"].exists():
        pack([f"procedural:0-{rooms - 1}", str(walk)], folders["road"], small)
    if not folders["large"].exists():
        clip = re10k.clip_of(nerfstudio.read(walk))
        copies = (replace(clip, key=f"{clip.key}_{number}") for number in range(COPIES))
        re10k.write(folders["large"], copies, 2 * re10k.CHUNK_BYTES)
    with tempfile.TemporaryDirectory() as spare:
        pack(["procedural:9000"], Path(spare), small)
        start = time.process_time()
        pack(["procedural:9001-9002"], Path(spare), small)
        return folders, (time.process_time() - start) / 2


def measured(folder: Path, work: Path, clips: int) -> tuple[list[dict], float]:
    """Rows by stage, and bytes of the store a sample."""
    from flows.corpus import SUPERVISE

    rows = []
    store, out = work / f"store-{folder.name}", work / f"out-{folder.name}"
    for index, stage in enumerate(SUPERVISE):
        words = str(folder), str(store), str(out), SUPERVISE[: index + 1], 1
        rows.append({"corpus": folder.name, "stage": stage, "clips": clips, **apart(child, *words)})
        print(rows[-1], file=sys.stderr, flush=True)
    size = sum(
        file.stat().st_size
        for spec in ("gaussians", "lesson", "sheet", "lessons", "pairs", "predictions")
        for file in (store / spec).rglob("*.*")
    )
    return rows, size / rows[-1]["items"]


def whole_retraining(folder: Path, work: Path) -> tuple[dict, dict, dict]:
    """Only what follows supervision; all of it from nothing, on two workers; all of it again."""
    done = str(folder), str(work / f"store-{folder.name}"), str(work / f"out-{folder.name}")
    training = apart(learning, *done, 1)
    print(training, file=sys.stderr, flush=True)
    anew = str(folder), str(work / "store-whole"), str(work / "out-whole")
    whole = apart(learning, *anew, 2)
    print(whole, file=sys.stderr, flush=True)
    return training, whole, apart(learning, *anew, 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("walk", type=Path, nargs="?")
    parser.add_argument("--rooms", type=int, default=200)
    parser.add_argument("--work", type=Path, help="folder for chunks and stores, kept")
    parser.add_argument("-o", "--out", type=Path, help="Markdown file")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        name, words = given.child
        print(json.dumps({"child": child, "learning": learning}[name](*json.loads(words))))
        return
    work = given.work or Path(tempfile.mkdtemp(prefix="slg-corpus-"))
    folders, room = packed(work, given.walk, given.rooms)
    clips = {"road": given.rooms + 1, "large": COPIES}
    stages, sizes, flows = [], {}, {}
    for name, folder in folders.items():
        rows, sizes[name] = measured(folder, work, clips[name])
        for row in rows:
            row["what"] = "views" if row["stage"] == "views" else "samples"
            row["rate"] = 60 * row["items"] / row["cpu"]
            row["scenes"] = 60 * row["clips"] / row["cpu"]
            row["flow"] = 1 - row["work"] / row["wall"]
        stages += rows
        flows[name] = 1 - sum(row["work"] for row in rows) / sum(row["wall"] for row in rows)
    named = zip(("training", "all", "again"), whole_retraining(folders["road"], work), strict=True)
    runs = [{"run": name, **cost} for name, cost in named]
    cost = {row["stage"]: row["cpu"] / row["items"] for row in stages if row["corpus"] == "large"}
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
            "disk": CLIPS * PICKED * sizes["road"] / 1e9,
            "memory": 2 * peak / 1024,
        }
        for n in MACHINES
    ]
    publish(
        "pipeline/corpus.md.j2",
        given.out,
        rows={"stages": stages, "runs": runs, "paper": paper},
        rooms=given.rooms,
        packing=room,
        sample=sizes["road"],
        flows=flows,
        learnt=runs[0],
        clips=CLIPS,
        views=VIEWS,
        picked=PICKED,
    )


if __name__ == "__main__":
    main()
