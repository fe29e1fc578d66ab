"""What a training set costs: to make, on disk by what it holds, and to read by a DataLoader.

    python -m benches.pipeline.training_set_cost [--rooms 6] [-o FILE]

Made-up rooms of 12 views become sets that differ in what they store. They share a store, so that
only what is stored is made anew. Each is read by :class:`slgaussian.datasets.TrainingSet` through a
``DataLoader`` with 0 and 2 workers, several times in turns, in one process that does nothing else.
"""

from __future__ import annotations

import argparse
import io
import json
import statistics
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from benches.common.pages import publish
from benches.common.process_cost import CLI, Cost, costing
from slgaussian.datasets.training_set import INDEX, TrainingSet

KINDS = {
    "jpg, depth": (),
    "png, depth": ("--set", "images=png"),
    "jpg, depth, Gaussians": ("--gaussians",),
    "png, depth, Gaussians": ("--set", "images=png", "--gaussians"),
}
"""What a set holds, and the options that make it so."""

TURNS, SAMPLES, WORKERS = 5, 64, (0, 2)

READ = """
import json, sys, time
import torch
from torch.utils.data import DataLoader, RandomSampler
from slgaussian.datasets import TrainingSet

def rate(samples, workers):
    # The same few samples over and over, in an order of their own: what is read is in memory.
    order = RandomSampler(samples, replacement=True, num_samples=count + 16)
    loader = iter(DataLoader(
        samples, batch_size=4, sampler=order, num_workers=workers, collate_fn=samples.collate
    ))
    for _ in range(4):  # while workers start
        next(loader)
    start, work = time.perf_counter(), time.process_time()
    for batch in loader:
        pass
    return count / (time.perf_counter() - start), 1e3 * (time.process_time() - work) / count

torch.set_num_threads(1)
count, turns, folders = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
sets = [TrainingSet(folder) for folder in folders]
for _ in range(turns):
    for number, samples in enumerate(sets):
        for workers in (0, 2):
            print(json.dumps([number, workers, *rate(samples, workers)]))
"""


def made(folder: Path, rooms: int, name: str, options: tuple[str, ...]) -> Cost:
    """Make a set of so many rooms in a folder."""
    words = ["dataset", folder / name, f"procedural:0-{rooms - 1}", "--targets", 1, "--most", 2]
    return costing([*CLI, *words, "--store", folder / "store", *options], status=(0, 1))


def read(folders: list[Path]) -> Iterator[tuple[int, int, float, float]]:
    """Yield of each set by its number, and number of workers: samples a second, CPU ms a sample."""
    cost = costing([sys.executable, "-c", READ, SAMPLES, TURNS, *folders])
    yield from (tuple(json.loads(line)) for line in cost.output if line.startswith("["))


def sizes(folder: Path) -> dict[str, float]:
    """Kilobytes of a sample by what its members are: means over the set."""
    samples = TrainingSet(folder)
    totals: dict[str, float] = {}
    for index in range(len(samples)):
        for name, data in samples.members(index).items():
            stem, ending = name.split(".")
            kind = stem if ending in ("npz", "json") else "images"
            totals[kind] = totals.get(kind, 0) + len(data) / 1e3 / len(samples)
    return totals


def overhead(folder: Path) -> float:
    """Share of the bytes of a set that is what its arrays say of themselves."""
    samples, said, whole = TrainingSet(folder), 0, 0
    for index in range(len(samples)):
        for name, data in samples.members(index).items():
            whole += len(data)
            if name.endswith(".npz"):
                with zipfile.ZipFile(io.BytesIO(data)) as archive:
                    own = archive.infolist()
                    said += sum(i.compress_size for i in own if not i.filename.endswith(".npy"))
    return said / whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("-o", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made(folder / "before", 1, "to compile kernels", ())
        costs = [made(folder, given.rooms, *kind) for kind in KINDS.items()]
        again = made(folder, given.rooms, next(iter(KINDS)), ())
        rates: dict[tuple[str, int], list[float]] = {}
        work: dict[str, list[float]] = {}
        kinds = list(KINDS)
        for number, workers, rate, spent in read([folder / kind for kind in kinds]):
            rates.setdefault((kinds[number], workers), []).append(rate)
            if not workers:
                work.setdefault(kinds[number], []).append(spent)
        rows: list[dict[str, Any]] = []
        for kind in KINDS:
            table = pq.read_table(folder / kind / INDEX)
            own = sizes(folder / kind)
            whole = sum(table["bytes"].to_pylist()) / 1e6
            clips = len(set(table["clip"].to_pylist()))
            rows.append(
                {
                    "kind": kind,
                    "sample": whole / table.num_rows,
                    "scene": whole / clips,
                    **{part: own.get(part, 0.0) for part in ("images", "geometry", "labels")},
                    "bank": own["bank"],
                    "gaussians": own.get("gaussians", 0.0),
                    "spent": statistics.median(work[kind]),
                    "said": 100 * overhead(folder / kind),
                    **{f"rate_{w}": statistics.median(rates[kind, w]) for w in WORKERS},
                    **{
                        f"spread_{w}": f"{min(rates[kind, w]):.0f} to {max(rates[kind, w]):.0f}"
                        for w in WORKERS
                    },
                }
            )
        publish(
            "pipeline/training_set.md.j2",
            given.o,
            rooms=given.rooms,
            samples=table.num_rows,
            clips=clips,
            first=costs[0],
            minute=60 * table.num_rows / costs[0].cpu,
            again=again,
            turns=TURNS,
            read=SAMPLES,
            rows=rows,
        )


if __name__ == "__main__":
    main()
