"""Cost of orchestration: `slgaussian run` of many small rooms, here and in an earlier checkout.

    python -m benches.pipeline.flow_overhead WORK EARLIER [--scenes 200] [--rounds 3]

The runs use threads and one worker: first with an empty store, then with everything cached, the two
checkouts in turn. For comparison, the library alone builds the same fields, without flow, stages,
store and scores. Printed are wall-clock and CPU seconds per scene, medians over the rounds; the
start, measured as a run of one scene, is subtracted.
"""

from __future__ import annotations

import os
import shutil
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

from benches.common.harness import ROOT, measured, parser
from benches.common.process_cost import CLI, Cost, costing
from benches.common.small_rooms import write_rooms

LIBRARY = """
import sys, tomllib
from pathlib import Path
from slgaussian import build_field, datasets
from slgaussian.components.method import Method

config = Path(sys.argv[1])
rooms = tomllib.loads(config.read_text())
for room in rooms["scenes"]:
    scene = datasets.load("nerfstudio", config.parent / room["path"])
    sample = scene.sample(
        room["context"], room["targets"], near=rooms["near"], far=rooms["far"]
    )
    build_field(sample, Method(replicas=rooms["replicas"]))
"""


def run(tree: Path, config: Path, work: Path) -> Cost:
    """Run a configuration with a checkout, in the store of ``work``; return its cost."""
    words = ["run", config, "-o", work / "out", "--store", work / "store", "--workers", 1]
    env = {**os.environ, "PYTHONPATH": str(tree)}
    return costing([*CLI, *words, "--runner", "threads"], cwd=tree, env=env)


def a_scene(many: Sequence[Cost], single: Sequence[Cost], scenes: int) -> str:
    """Return wall-clock and CPU seconds per scene after the first, as cells."""
    cells = []
    for name in ("wall", "cpu"):
        first, last = (
            statistics.median(getattr(c, name) for c in costs) for costs in (single, many)
        )
        cells.append(f"{(last - first) / (scenes - 1):.3f}")
    return " | ".join(cells)


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("work", type=Path, help="folder for photographs and stores")
    arguments.add_argument("earlier", type=Path, help="a checkout of another commit")
    arguments.add_argument("--scenes", type=int, default=200)
    arguments.add_argument("--rounds", type=int, default=3, help="of runs with everything cached")
    args = arguments.parse_args()
    work, trees = args.work.resolve(), {"now": ROOT, "earlier": args.earlier.resolve()}
    costs: dict[tuple[str, str, int], list[Cost]] = {}
    for count in (1, args.scenes):
        config = write_rooms(work / f"rooms-{count}", count)
        library = [sys.executable, "-c", LIBRARY, config]
        for turn in range(args.rounds + 1):
            for name, tree in trees.items():
                place = work / f"{name}-{count}"
                if not turn:
                    shutil.rmtree(place, ignore_errors=True)
                state = "cached" if turn else "computed"
                costs.setdefault((name, state, count), []).append(run(tree, config, place))
                print(name, state, count, os.getloadavg()[0], costs[name, state, count][-1].wall,
                      costs[name, state, count][-1].cpu, file=sys.stderr, flush=True)  # fmt: skip
        costs["library", "computed", count] = [costing(library, cwd=ROOT)]
    print(f"{measured()}; load {os.getloadavg()[1]:.1f}\n")
    print("| program | stages | wall, s a scene | processor, s a scene |\n|---|---|--:|--:|")
    for name, state in dict.fromkeys(key[:2] for key in costs):
        many, single = (costs[name, state, count] for count in (args.scenes, 1))
        print(f"| {name} | {state} | {a_scene(many, single, args.scenes)} |")


if __name__ == "__main__":
    main()
