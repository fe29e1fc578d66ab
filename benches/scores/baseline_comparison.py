"""Scores and costs of every method of the benchmark.

    python -m benches.scores.baseline_comparison OUT [-o docs/measured] [--only METHOD ...]

OUT is the output folder of a benchmark with ``--against``, which has scores and times.
"""

from pathlib import Path

import pyarrow.parquet as pq

from benches.common.harness import Format, parser, publish, table
from slgaussian.benchmark.costs import measure_costs
from slgaussian.benchmark.scores import Rows

SETS = {"office": "office", "procedural": "rooms"}
"""Data sets, and their names in the table."""

SCORES = ("iou", "hit_mask", "miou")


def read_scores(out: Path) -> dict[str, dict]:
    """Return the scores of each method by data set."""
    scores_of: dict[str, dict] = {}
    for score in pq.read_table(out / "scores.parquet").to_pylist():
        of, metric = scores_of.setdefault(score["method"], {}), score["metric"]
        if score["protocol"].startswith("slgaussian@") and metric in SCORES:
            of[f"{score['dataset']}_{metric}"] = score["value"]
            if metric == "iou" and score["low"] is not None:
                of[f"{score['dataset']}_ends"] = f"{score['low']:.3f}–{score['high']:.3f}"
    return scores_of


def read_seconds(out: Path) -> dict[str, dict]:
    """Return the seconds of each method, medians over all scenes."""
    rows = pq.read_table(out / "times.parquet").to_pylist()
    return {
        cost.method: {
            "prepare": cost.prepare or 0.0,
            "first_query": cost.view_query or 0.0,
            "further_query": cost.further_query or 0.0,
        }
        for cost in measure_costs(Rows.from_rows(({**row, "dataset": ""} for row in rows), "times"))
    }


COLUMNS: dict[str, tuple[str, Format]] = {"method": ("method", str)}
for _set, _title in SETS.items():
    COLUMNS[f"{_set}_iou"] = (f"{_title}: IoU", ".3f")
    COLUMNS[f"{_set}_ends"] = ("interval", str)
    COLUMNS[f"{_set}_hit_mask"] = ("point", ".2f")
    COLUMNS[f"{_set}_miou"] = ("mIoU", ".3f")
COLUMNS |= {
    "prepare": ("prepare, s", ".3f"),
    "first_query": ("first query, s", ".3f"),
    "further_query": ("further, s", ".4f"),
}


def main() -> None:
    arguments = parser(__doc__, "answers.md")
    arguments.add_argument("run", type=Path, help="what the benchmark left")
    arguments.add_argument("--only", nargs="*", metavar="METHOD")
    args = arguments.parse_args()
    answers, costs = read_scores(args.run), read_seconds(args.run)
    rows = [{"method": name, **answers[name], **costs[name]} for name in args.only or answers]
    command = "python -m benches.scores.baseline_comparison OUT"
    publish(args.out, "answers.md", command, table(rows, COLUMNS))


if __name__ == "__main__":
    main()
