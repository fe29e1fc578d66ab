"""Waiting times at the command line, compared with an earlier commit in turn.

    python -m benches.pipeline.waiting DATA EARLIER [-o docs/measured] [--rounds 5] [--only NAME]

DATA holds photographs with cameras and pairs.json, as the office set does. EARLIER is a folder with
a checkout of another commit; it uses the packages that are installed here. Each command runs once
before it is measured, to compile kernels and cache files; then the two commits run in turn. Queries
in Python are timed within one process, without the first two rounds. ``first field`` compiles its
kernels each time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benches.common.harness import ROOT, parser, publish, table
from benches.common.photograph_pairs import photographs
from benches.common.process_cost import Cost, costing
from slgaussian.benchmark.statistics import interval, resamplings

FIRST = "first field"

QUERIES = ("first query, new view", "first query, rendered view", "100 texts")
"""Rows of the table that :data:`QUERY_SCRIPT` measures within one process."""

QUERY_SCRIPT = """
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


def program(folder: Path) -> tuple[str, ...]:
    """Return the command that starts the command line of a checkout."""
    project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))
    module, function = project["project"]["scripts"]["slgaussian"].split(":")
    return sys.executable, "-c", f"from {module} import {function}; {function}()"


def compare_costs(command: str, now: Sequence[Cost], before: Sequence[Cost]) -> dict[str, object]:
    """Return medians of two commits over rounds, and an interval of the ratio of seconds."""
    ratios = np.array([a.cpu / b.cpu for a, b in zip(now, before, strict=True)])
    low, high = interval(np.median(ratios[resamplings(len(ratios))], 1))
    medians = {
        f"{name}{end}": float(np.median([getattr(cost, name) for cost in costs]))
        for end, costs in (("", now), ("_before", before))
        for name in ("cpu", "wall", "peak")
    }
    ends = {"ratio": float(np.median(ratios)), "low": low, "high": high, "rounds": len(ratios)}
    return {"command": command, **medians, **ends}


def in_turn(
    words: Sequence[str], folders: Sequence[Path], rounds: int, first: bool = False
) -> tuple[list[Cost], list[Cost]]:
    """Return the costs of a command for the two checkouts, run in turn.

    ``{}`` in its words is 0 for the first and 1 for the second. With ``first`` each run compiles
    the kernels into an empty folder; otherwise the first round does not count.
    """
    costs: tuple[list[Cost], list[Cost]] = ([], [])
    for turn in range(rounds + (not first)):
        for k, folder in enumerate(folders):
            with tempfile.TemporaryDirectory() as empty:
                env = dict(os.environ)
                env.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has its bytecode
                if first:
                    env["NUMBA_CACHE_DIR"] = empty
                command = [*program(folder), *(word.replace("{}", str(k)) for word in words)]
                cost = costing(command, cwd=folder, env=env)
            if turn or first:
                costs[k].append(cost)
    return costs


def query_in_turn(field: str, folders: Sequence[Path], rounds: int) -> dict[str, tuple]:
    """Return the costs of :data:`QUERIES` for the two checkouts, the minimum in each process."""
    costs: dict[str, tuple[list[Cost], list[Cost]]] = {name: ([], []) for name in QUERIES}
    for _ in range(rounds):
        for k, folder in enumerate(folders):
            words = [sys.executable, "-c", QUERY_SCRIPT, field.replace("{}", str(k))]
            answer = costing(words, cwd=folder).output[-1]
            for name, (wall, cpu, peak) in json.loads(answer).items():
                costs[name][k].append(Cost(wall=wall, cpu=cpu, peak=peak))
    return costs


COLUMNS = {
    "command": ("command", str),
    "cpu_before": ("CPU before, s", ".3g"),
    "cpu": ("CPU now, s", ".3g"),
    "ratio": ("ratio", ".2f"),
    "low": ("from", ".2f"),
    "high": ("to", ".2f"),
    "wall_before": ("wall before, s", ".3g"),
    "wall": ("wall now, s", ".3g"),
    "peak_before": ("MB before", ",.0f"),
    "peak": ("MB now", ",.0f"),
    "rounds": ("rounds", "d"),
}


def main() -> None:
    arguments = parser(__doc__, "waiting.md")
    arguments.add_argument("data", type=photographs)
    arguments.add_argument("earlier", type=Path)
    arguments.add_argument("--rounds", type=int, default=5)
    arguments.add_argument("--only", nargs="*", help="rows of the table, by their names")
    args = arguments.parse_args()
    folders = (ROOT, args.earlier.resolve())
    git = ["git", "-C", str(folders[1]), "rev-parse", "--short=7", "HEAD"]
    earlier = subprocess.run(git, capture_output=True, text=True).stdout.strip() or "unknown"
    pair = next(iter(json.loads((args.data / "pairs.json").read_text()).values()))
    photos = [str((args.data / name).resolve()) for name in pair["context"]]
    cameras = str((args.data / "transforms.json").resolve())

    def wants(name: str) -> bool:
        return not args.only or name in args.only

    with tempfile.TemporaryDirectory() as place:
        field = ("field", *photos, "--cameras", cameras, "-o", f"{place}/{{}}")
        in_turn(field, folders, 0)  # something to ask
        query = ("query", f"{place}/{{}}", "blue carpet")
        commands = {
            "field, a pair": field,
            "field, no cameras": ("field", *photos, "-o", f"{place}/no-cameras-{{}}"),
            "query": query,
            "query --out": (*query, "-o", f"{place}/{{}}.png"),
            "help": ("--help",),
            "words": ("words",),
        }
        rows = []
        for name, words in commands.items():
            if wants(name):
                rows.append(compare_costs(name, *in_turn(words, folders, args.rounds)))
                print(rows[-1], file=sys.stderr)
        if any(map(wants, QUERIES)):
            costs = query_in_turn(f"{place}/{{}}", folders, args.rounds)
            rows += [compare_costs(name, *costs[name]) for name in QUERIES]
        if wants(FIRST):
            rows.append(compare_costs(FIRST, *in_turn(field, folders, args.rounds, first=True)))
    publish(
        args.out,
        "waiting.md",
        "python -m benches.pipeline.waiting DATA EARLIER",
        f"Before is commit {earlier}.",
        table(rows, COLUMNS),
    )


if __name__ == "__main__":
    main()
