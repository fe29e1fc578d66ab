"""What people wait for at the command line, beside an earlier commit, in turn.

    python -m benches.pipeline.waiting DATA EARLIER [-o FILE] [--rounds N] [--only WORDS ...]

DATA holds photographs with cameras and pairs.json, as the office set does. EARLIER is a folder with
a checkout of another commit; it runs with the packages that are installed here. Each command runs
once before it is measured, so that kernels are compiled and files are in memory; then the two
commits take turns. What is asked in Python is timed within a process, after the first two times.
``first field`` has an empty folder for kernels each time. With ``--only`` what else was
measured of the same commit stays.

With ``-o docs/measured/waiting.md`` the rows are also appended to ``waiting.json`` beside it, the
history that the page shows. A command is called slower where the interval of its ratio to the
earlier commit lies above that of the last time.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import photographs
from benches.common.process_cost import Cost, costing
from slgaussian.io import write_atomic

HERE = Path(__file__).parents[2]
DRAWS = 2000
FIRST = "first field"

ASKED = ("first query, new view", "first query, rendered view", "100 texts")
"""What is timed within one process, by :data:`ASK`."""

ASK = """
import json, resource, sys, time
from slgaussian.field import SemanticField

field = SemanticField.load(sys.argv[1])
a, b = list(field.cameras.values())[:2]
words = "chair table floor wall door window lamp plant sofa box".split()
texts = [f"{colour} {word}" for colour in (
    "red", "green", "blue", "white", "black", "brown", "grey", "yellow", "orange", "beige"
) for word in words]
costs = {}

def timed(name, work):
    start, spent = time.perf_counter(), time.process_time()
    made = work()
    cost = time.perf_counter() - start, time.process_time() - spent
    costs.setdefault(name, []).append(cost)
    return made

for turn in range(8):
    between = (a, b)[turn % 2]  # of another view than the last time
    timed("first query, new view", lambda: field.render(between).query(texts[turn]))
    view = field.render(between)
    timed("first query, rendered view", lambda: view.query(texts[turn + 10]))
    timed("100 texts", lambda: [(r.mask, r.relevancy, r.point) for r in view.query_all(texts)])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({name: [min(w for w, _ in own[2:]), min(c for _, c in own[2:]), peak]
                  for name, own in costs.items()}))
"""


@dataclass(frozen=True)
class Row:
    """One command: medians over the rounds of this commit and the earlier one.

    ``low`` and ``high`` are the ends of a 95 % bootstrap interval of ``ratio``, the median over the
    rounds of this commit's processor seconds over the earlier one's.
    """

    command: str
    cpu: float
    cpu_before: float
    wall: float
    wall_before: float
    peak: float
    peak_before: float
    ratio: float
    low: float
    high: float
    rounds: int


def program(folder: Path) -> tuple[str, ...]:
    """What starts the command line of a checkout."""
    told = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))
    module, function = told["project"]["scripts"]["slgaussian"].split(":")
    return sys.executable, "-c", f"from {module} import {function}; {function}()"


def row_of(command: str, now: Sequence[Cost], before: Sequence[Cost]) -> Row:
    """The row of costs of two commits, taken in turn."""
    ratios = np.array([a.cpu / b.cpu for a, b in zip(now, before, strict=True)])
    drawn = np.random.default_rng(0).integers(0, len(ratios), (DRAWS, len(ratios)))
    low, high = np.quantile(np.median(ratios[drawn], 1), (0.025, 0.975)).tolist()
    both = {
        f"{name}{end}": float(np.median([getattr(cost, name) for cost in costs]))
        for end, costs in (("", now), ("_before", before))
        for name in ("cpu", "wall", "peak")
    }
    return Row(command, **both, ratio=float(np.median(ratios)), low=low, high=high,
               rounds=len(ratios))  # fmt: skip


def slower(rows: Sequence[Row], last: Sequence[Row]) -> list[str]:
    """The commands whose ratio to the earlier commit rose beyond noise since the last time."""
    known = {row.command: row for row in last}
    return [r.command for r in rows if r.command in known and r.low > known[r.command].high]


def measured(words: Sequence[str], folders: Sequence[Path], rounds: int) -> tuple[list, list]:
    """Costs of a command here and there, in turn. ``{}`` among the words is 0 here and 1 there."""
    costs: tuple[list[Cost], list[Cost]] = ([], [])
    for number in range(rounds + 1):
        for k, folder in enumerate(folders):
            given = [word.replace("{}", str(k)) for word in words]
            cost = costing([*program(folder), *given], cwd=folder)
            if number:
                costs[k].append(cost)
    return costs


def first_field(words: Sequence[str], folders: Sequence[Path], rounds: int) -> tuple[list, list]:
    """Costs of the first command ever: its kernels are compiled into an empty folder."""
    costs: tuple[list[Cost], list[Cost]] = ([], [])
    for _ in range(rounds):
        for k, folder in enumerate(folders):
            with tempfile.TemporaryDirectory() as empty:
                given = [word.replace("{}", str(k)) for word in words]
                own = {**os.environ, "NUMBA_CACHE_DIR": empty}
                costs[k].append(costing([*program(folder), *given], cwd=folder, env=own))
    return costs


def told(words: Sequence[str], folders: Sequence[Path], rounds: int) -> dict[str, tuple]:
    """Costs of :data:`ASKED` here and there, in turn: the least of some asked of a field each time.

    ``words`` is the folder of the field, with ``{}`` as in :func:`measured`.
    """
    costs: dict[str, tuple[list[Cost], list[Cost]]] = {name: ([], []) for name in ASKED}
    for _ in range(rounds):
        for k, folder in enumerate(folders):
            given = [word.replace("{}", str(k)) for word in words]
            said = costing([sys.executable, "-c", ASK, *given], cwd=folder).output[-1]
            for name, (wall, cpu, peak) in json.loads(said).items():
                costs[name][k].append(Cost(wall=wall, cpu=cpu, peak=peak))
    return costs


def commit(folder: Path) -> str:
    told = subprocess.run(
        ["git", "rev-parse", "--short=7", "HEAD"], cwd=folder, capture_output=True, text=True
    )
    return told.stdout.strip() or "unknown"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=photographs)
    parser.add_argument("earlier", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", nargs="*", help="commands, by their first word")
    given = parser.parse_args()
    folders = (HERE, given.earlier.resolve())
    pair = next(iter(json.loads((given.data / "pairs.json").read_text()).values()))
    photos = [str((given.data / name).resolve()) for name in pair["context"]]
    with tempfile.TemporaryDirectory() as place:
        cameras = str((given.data / "transforms.json").resolve())
        field = ("field", *photos, "--cameras", cameras, "-o", f"{place}/{{}}")
        for k, folder in enumerate(folders):  # something to ask
            costing([*program(folder), *[word.replace("{}", str(k)) for word in field]], cwd=folder)
        asked = ("query", f"{place}/{{}}", "chair")
        commands = {
            "field, a pair": field,
            "query": asked,
            "query --out": (*asked, "-o", f"{place}/{{}}.png"),
            "help": ("--help",),
            "words": ("words",),
        }
        rows = []
        for name, words in commands.items():
            if given.only and name not in given.only:
                continue
            few = min(3 if words[0] == "field" else given.rounds, given.rounds)
            rows.append(row_of(name, *measured(words, folders, few)))
            print(rows[-1], file=sys.stderr)
        if not given.only or set(ASKED) & set(given.only):
            costs = told((f"{place}/{{}}",), folders, given.rounds)
            rows += [row_of(name, *costs[name]) for name in ASKED]
        if not given.only or FIRST in given.only:
            rows.append(row_of(FIRST, *first_field(field, folders, min(3, given.rounds))))
    history = given.out.with_suffix(".json") if given.out else None
    runs: list[dict[str, Any]] = []
    if history is not None and history.exists():
        runs = json.loads(history.read_text())
    here, there = map(commit, folders)
    day = datetime.now(UTC).date().isoformat()
    if runs and runs[-1]["commit"] == here:
        again = {row.command for row in rows}
        kept = [Row(**row) for row in runs.pop()["rows"] if row["command"] not in again]
        rows = [*kept, *rows]
    last = [Row(**row) for row in runs[-1]["rows"]] if runs else []
    runs.append({"commit": here, "day": day, "rows": [asdict(row) for row in rows]})
    said = slower(rows, last)
    publish(
        "pipeline/waiting.md.j2", given.out,
        rows=[asdict(row) for row in rows], earlier=there, slower=said,
        history=[
            {"day": run["day"], "commit": run["commit"]}
            | {row["command"]: row["cpu"] for row in run["rows"]}
            for run in runs
        ],
        columns={"day": ("day", str), "commit": ("commit", str)}
        | {row.command: (row.command, ".3g") for row in rows},
        call=shlex.join(["python", "-m", "benches.pipeline.waiting", "DATA", "EARLIER"]),
    )  # fmt: skip
    if history is not None:
        write_atomic(history, (json.dumps(runs, indent=1) + "\n").encode())
    if said:
        raise SystemExit(f"slower beyond noise than the last time: {', '.join(said)}")


if __name__ == "__main__":
    main()
