"""What it costs to add one photograph to a field, against a field of all photographs at once.

    python -m benches.views.added_photographs DATA [--views 3,9] [--first 0]

DATA is a posed walk, as ``office_walk``: every second of its frames is a view, with the cameras
that it comes with. Seconds are those of the processor of the whole command, its start included.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benches.common.markdown_tables import table
from benches.common.photograph_pairs import data_folder
from benches.common.process_cost import CLI, Cost, costing
from benches.views.built_fields import Row, whole_numbers
from slgaussian import datasets

STEP = 2


def added(walk: Path, first: int, number: int, room: Path) -> Row:
    """The last of so many views added to the field of the others; SystemExit unless the Gaussians
    are those of all at once."""
    names = list(datasets.load("nerfstudio", walk).cameras)[first::STEP][:number]
    cameras = ["--cameras", walk / "transforms.json"]

    def field(*words: object) -> Cost:
        return costing([*CLI, "field", *words])

    field(*names[:-1], *cameras, "-o", room / "before")
    held = (room / "before/derived.npz").stat().st_size
    later = field("--add", names[-1], room / "before", "-o", room / "added")
    anew = field(*names, *cameras, "-o", room / "anew")
    found = [(room / name / "gaussians.npz").read_bytes() for name in ("added", "anew")]
    if found[0] != found[1]:
        raise SystemExit(f"{number} views: the Gaussians are not those of all at once")
    told = next(line for line in reversed(later.output) if "reused" in line)
    cost: Row = {"views": number, "added": later.cpu, "anew": anew.cpu, "held": held / 2**20}
    return cost | {"share": later.cpu / anew.cpu, "reused": told.split("reused ")[1]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=data_folder("transforms.json"))
    parser.add_argument("--views", type=whole_numbers, default=(3, 9))
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    rows = []
    for number in given.views:
        if number > 2:
            with tempfile.TemporaryDirectory() as room:
                rows.append(added(given.data, given.first, number, Path(room)))
    columns = {
        "views": ("views", "d"),
        "added": ("the last added, CPU s", ".1f"),
        "anew": ("all at once, CPU s", ".1f"),
        "share": ("share", ".2f"),
        "held": ("derived.npz before, MB", ".1f"),
        "reused": ("reused", str),
    }
    print(table(rows, columns))


if __name__ == "__main__":
    main()
