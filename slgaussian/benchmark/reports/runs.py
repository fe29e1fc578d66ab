"""Methods of several runs ranked, and the folders that runs leave.

Only what was asked the same is in one table: the same queries of the same frames of the same
scenes, by the same version of a protocol, judged at the same size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.benchmark.costs import Cost, costs_of
from slgaussian.benchmark.reports.model import Column, Table, number
from slgaussian.benchmark.reports.score_tables import MAIN, MORE, Score, score_cell
from slgaussian.benchmark.scores import METRICS, key_of, score_table
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.storage.specs import load_spec
from slgaussian.storage.tables import read_table

Row = Mapping[str, Any]

EXPECTED = "expected a folder that benchmark, run or demo wrote"


@dataclass(frozen=True)
class Run:
    """What a run left in a folder: samples, manifest, times and costs, empty if there are none."""

    folder: Path
    rows: list[Row]
    manifest: Mapping[str, Any]
    times: Mapping[str, Any] = field(default_factory=dict)
    costs: Sequence[Cost] = ()

    @property
    def by_method(self) -> dict[str, list[Row]]:
        """The samples of each method, ours first."""
        by_method: dict[str, list[Row]] = {}
        for row in self.rows:
            by_method.setdefault(row["method"], []).append(row)
        return by_method


def read_run(folder: str | Path) -> Run:
    """Read what a run left.

    Raises
    ------
    InputError
        If there is no ``samples.parquet``, or it or the manifest is not what a run leaves.
    """
    folder = Path(folder)
    file = folder / "samples.parquet"
    if not file.is_file():
        raise InputError(f"{file}: found no such file, {EXPECTED}")
    table = _read_table("samples", file)
    manifest, times = (_read_mapping(folder / name) for name in ("manifest.json", "times.json"))
    costs = folder / "times.parquet"
    rows = _read_table("times", costs).to_pylist() if costs.is_file() else []
    return Run(folder, table.to_pylist(), manifest, times, costs_of(rows))


def _read_table(spec: str, file: Path) -> pa.Table:
    try:
        table = read_table(file)
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read ({reason}); {EXPECTED}") from error
    load_spec(spec).check_table(table, str(file))
    return table


def _read_mapping(file: Path) -> dict[str, Any]:
    try:
        content = strict_json.parse(file.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}); run the benchmark again") from error
    if not isinstance(content, dict):
        raise InputError(f"{file}: found no JSON object; run the benchmark again")
    return content


def rank_methods(runs: Sequence[Run]) -> list[Table]:
    """Rank the methods of runs by the first score of each protocol; equal as printed is equal.

    There is a table for each data set, protocol, size and list of questions; the truth is the same
    where the manifests know it.

    Raises
    ------
    InputError
        If a run is given twice, or has no scored sample.
    """
    groups: dict[tuple[str, str, str], list[list[_Entry]]] = {}
    for place, run in enumerate(runs):
        if run.folder.resolve() in [other.folder.resolve() for other in runs[:place]]:
            raise InputError(f"compare: {run.folder} is given twice; give each folder once")
        entries = _entries(run)
        if not entries:
            raise InputError(
                f"{run.folder}: found no scored sample, expected what benchmark or score wrote "
                "with labels; leave this folder out"
            )
        for kind, entry in entries:
            alike = groups.setdefault(kind, [])
            same = next((group for group in alike if group[0].is_like(entry)), None)
            if same is None:
                alike.append([entry])
            else:
                same.append(entry)
    order = list(dict.fromkeys(score.protocol for score in (*MAIN, *MORE)))
    return [
        _ranking(kind, group)
        for kind in sorted(groups, key=lambda kind: order.index(kind[1].partition("@")[0]))
        for group in sorted(groups[kind], key=len, reverse=True)
    ]


@dataclass(frozen=True)
class _Entry:
    """A method of a run with what it was asked, the truth's digest by scene, and its scores."""

    run: Run
    method: str
    asked: frozenset[tuple[str, str, str]]
    truth: Mapping[str, str]
    scores: Mapping[str, Row]
    seconds: float | None

    def is_like(self, other: _Entry) -> bool:
        shared = self.truth.keys() & other.truth.keys()
        same_truth = all(self.truth[scene] == other.truth[scene] for scene in shared)
        return self.asked == other.asked and same_truth


def _entries(run: Run) -> list[tuple[tuple[str, str, str], _Entry]]:
    seconds = {(cost.dataset, cost.method): cost.view_query for cost in run.costs}
    data = run.manifest.get("data", {})
    entries = []
    for method, rows in run.by_method.items():
        kinds: dict[tuple[str, str, str], list[Row]] = {}
        for row in rows:
            size = f"{row['height']} x {row['width']}"
            kinds.setdefault((row["dataset"], row["protocol"], size), []).append(row)
        for kind, own in kinds.items():
            scores = {score["metric"]: score for score in score_table(own).to_pylist()}
            if not any(score.metric in scores for score in _ranked_scores(kind[1])):
                continue
            asked = frozenset(
                key_of(row) for row in own if any(m.of(row) is not None for m in METRICS)
            )
            digests = {scene: data.get(scene, {}).get("truth") for scene, *_ in asked}
            truth = {scene: digest for scene, digest in digests.items() if digest is not None}
            spent = seconds.get((kind[0], method))
            entries.append((kind, _Entry(run, method, asked, truth, scores, spent)))
    return entries


def _ranked_scores(protocol: str) -> list[Score]:
    """List the scores of a protocol that are the better the greater."""
    name = protocol.partition("@")[0]
    return [score for score in (*MAIN, *MORE) if score.protocol == name and score.sign > 0]


def _ranking(kind: tuple[str, str, str], group: Sequence[_Entry]) -> Table:
    shown = [s for s in _ranked_scores(kind[1]) if any(s.metric in e.scores for e in group)]

    def value(entry: _Entry) -> float:
        score = entry.scores.get(shown[0].metric)
        return -1.0 if score is None else round(score["value"], shown[0].digits)

    rows = []
    for entry in sorted(group, key=value, reverse=True):
        rank = 1 + sum(value(other) > value(entry) for other in group)
        cells = [score_cell(entry.scores.get(score.metric), score.digits) for score in shown]
        seconds = number(entry.seconds, 3)
        rows.append([str(rank), entry.method, str(entry.run.folder), *cells, seconds])
    names = [Column(name, is_text=True) for name in ("#", "method", "run")]
    scenes = len({scene for scene, *_ in group[0].asked})
    dataset, protocol, size = kind
    title = f"{dataset} by {protocol} at {size}: {scenes} scenes, {len(group[0].asked)} queries"
    return Table.of([*names, *(score.column() for score in shown), "s"], rows, title)
