"""What a training set costs: to make, on disk by what it holds, and to read by a DataLoader.

    python -m benches.pipeline.training_set_cost [--rooms 6] [-o docs/measured]

Made-up rooms of 12 views become sets that differ in what they store. They share a store, so that
only what is stored is made anew. Each is read by :class:`slgaussian.datasets.TrainingSet` through a
``DataLoader`` with 0 and 2 workers, several times in turns, in one process that does nothing else.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from benches.common.harness import parser, publish, table
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


COLUMNS = {
    "kind": ("holds", str),
    "images": ("images, kB", ",.0f"),
    "geometry": ("cameras and depth, kB", ",.0f"),
    "labels": ("labels, kB", ",.0f"),
    "bank": ("bank, kB", ",.0f"),
    "gaussians": ("Gaussians, kB", ",.0f"),
    "sample": ("MB a sample", ".2f"),
    "scene": ("MB a scene", ".2f"),
    "spent": ("CPU ms to read a sample", ".1f"),
    "rate_0": ("samples a second, 0 workers", ",.0f"),
    "rate_2": ("2 workers", ",.0f"),
}


def main() -> None:
    arguments = parser(__doc__, "scale.md")
    arguments.add_argument("--rooms", type=int, default=6)
    asked = arguments.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made(folder / "before", 1, "to compile kernels", ())
        first, *_ = [made(folder, asked.rooms, *kind) for kind in KINDS.items()]
        again = made(folder, asked.rooms, next(iter(KINDS)), ())
        rates: dict[tuple[str, int], list[float]] = {}
        spent: dict[str, list[float]] = {}
        kinds = list(KINDS)
        for number, workers, rate, seconds in read([folder / kind for kind in kinds]):
            rates.setdefault((kinds[number], workers), []).append(rate)
            if not workers:
                spent.setdefault(kinds[number], []).append(seconds)
        rows: list[dict[str, Any]] = []
        for kind in KINDS:
            index = pq.read_table(folder / kind / INDEX)
            megabytes = sum(index["bytes"].to_pylist()) / 1e6
            row = {"kind": kind, "sample": megabytes / index.num_rows}
            row |= {"scene": megabytes / len(set(index["clip"].to_pylist()))}
            row |= {"spent": statistics.median(spent[kind]), **sizes(folder / kind)}
            rows.append(row | {f"rate_{w}": statistics.median(rates[kind, w]) for w in WORKERS})
    publish(
        asked.out,
        "scale.md",
        f"python -m benches.pipeline.training_set_cost --rooms {asked.rooms}",
        f"The first set took {first.cpu:.0f} CPU s and {first.peak:,.0f} MB of memory, "
        f"{60 * index.num_rows / first.cpu:.1f} samples a minute of one core; the same again, "
        f"where nothing is new, {again.cpu:.1f} CPU s.",
        table(rows, COLUMNS),
    )


if __name__ == "__main__":
    main()
