"""Runs compared: how they were made, methods ranked, by how much scores differ, and costs.

Only what was asked the same counts: the same query of the same frame, by the same version of a
protocol, judged at the same size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import ascii_uppercase
from typing import Any

import pyarrow as pa

from slgaussian.benchmark.costs import Cost, costs_of
from slgaussian.benchmark.documents import read_json
from slgaussian.benchmark.outputs import mask_place
from slgaussian.benchmark.reports.model import (
    NO_VALUE,
    Block,
    Column,
    Fold,
    Prose,
    Report,
    Section,
    Table,
    escape,
    flatten,
    number,
)
from slgaussian.benchmark.reports.score_tables import (
    MAIN,
    MORE,
    Score,
    difference_tables,
    score_cell,
)
from slgaussian.benchmark.scores import METRICS, key_of, of_first_protocol, score_table
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from slgaussian.storage.tables import read_table

Row = Mapping[str, Any]

EXPECTED = "expected a folder that benchmark, run or demo wrote"

CHANGED = 8
"""Queries that are shown, those whose IoU changed most."""

COSTS = {
    "prepare": ("to prepare a scene, s", 1.0, 4),
    "view_query": ("a query in a new view, s", 1.0, 4),
    "grown": ("memory, MB", 1e6, 0),
}
"""Of each :class:`Cost` what is compared: in words, its unit, and digits."""

SCENES = 3
"""Scenes whose data differ that are named one by one, at most."""

OPENING = (
    "Only what was asked the same is compared, or in one table. Intervals hold 95% of the means if "
    "scenes are drawn anew; s: median seconds of a query in a new view."
)


@dataclass(frozen=True)
class Run:
    """Files that a run left: samples, manifest, times and costs, empty if there are none."""

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
    if not (folder / "samples.parquet").is_file():
        raise InputError(f"{folder / 'samples.parquet'}: found no such file, {EXPECTED}")
    manifest, times = (_read_document(folder / name) for name in ("manifest.json", "times.json"))
    rows, costs = (_read_rows(name, folder / f"{name}.parquet") for name in ("samples", "times"))
    return Run(folder, rows, manifest, times, costs_of(costs))


def _read_document(file: Path) -> dict[str, Any]:
    content = read_json(file, "document") if file.exists() else {}
    if not isinstance(content, dict):
        raise InputError(f"{file}: found no JSON object; run the benchmark again")
    return content


def _read_rows(spec: str, file: Path) -> list[Row]:
    if not file.is_file():
        return []
    try:
        table = read_table(file)
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read ({reason}); {EXPECTED}") from error
    load_spec(spec).check_table(table, str(file))
    rows: list[Row] = table.to_pylist()
    return rows


def compare_runs(runs: Sequence[Run]) -> Report:
    """Compare runs, each with the first, and rank their methods.

    Raises
    ------
    InputError
        If there are fewer than two, more than the alphabet has letters, or one is given twice.
    """
    if not 2 <= len(runs) <= len(ascii_uppercase):
        raise InputError(
            f"compare: found {len(runs)} run{'s' if runs[1:] else ''}, expected 2 to "
            f"{len(ascii_uppercase)}"
        )
    for place, run in enumerate(runs):
        if run.folder.resolve() in [other.folder.resolve() for other in runs[:place]]:
            raise InputError(f"compare: {run.folder} is given twice; give each folder once")
    named = dict(zip(ascii_uppercase, runs, strict=False))
    sections = [Section("What is compared", [_runs_table(named)])]
    manifests = {letter: run.manifest for letter, run in named.items() if run.manifest}
    block: Block = Prose("No setting, version or data is known to differ.")
    if settings := differing_settings(list(manifests.values())):
        block = Table.of([Column(n, is_text=True) for n in ("what differs", *manifests)], settings)
    sections.append(Section("How they were made", [block]))
    if rankings := rank_methods(named):
        first = [table for table in rankings if f" by {MAIN[0].protocol}@" in table.title]
        others = [table for table in rankings if table not in first]
        folds = [Fold("By other protocols", others)] if first and others else others
        sections.append(Section("Methods ranked", [*first, *folds]))
    sections += _difference_sections(named)
    if all(run.times for run in runs):
        sections.append(Section("What they cost", [_costs_table(runs)]))
    if len(runs) == 2 and (changes := _changes_table(*runs)):
        sections.append(Section("IoU that changed most", [changes]))
    return Report("Runs compared", [Prose(OPENING)], sections)


def _runs_table(named: Mapping[str, Run]) -> Table:
    """List the runs, and how much of what each was asked the first was asked too."""
    first = next(iter(named.values()))
    rows = []
    for letter, run in named.items():
        pairs = [pair for _, mine, theirs in _paired(first, run) for pair in _aligned(mine, theirs)]
        same = sum({**a, "method": ""} == {**b, "method": ""} for a, b in pairs)
        scenes = len({row["scene"] for row in run.rows})
        counts = (scenes, len(run.by_method), len(run.rows), len(pairs), len(pairs) - same)
        rows.append([letter, str(run.folder), *map(str, counts)])
    heads = ["", Column("Run", is_text=True), "Scenes", "Methods", "Samples", "As in A", "Changed"]
    return Table.of(heads, rows)


def _paired(first: Run, second: Run) -> Iterator[tuple[str, list[Row], list[Row]]]:
    """Pair the samples of each method that both have; if none, those of their own methods."""
    earlier, later = first.by_method, second.by_method
    shared = [name for name in earlier if name in later]
    for name in shared:
        yield name, earlier[name], later[name]
    if not shared and earlier and later:
        (name, rows), (other, others) = next(iter(earlier.items())), next(iter(later.items()))
        yield f"{other} − {name}", rows, others


def _aligned(rows: Sequence[Row], others: Sequence[Row]) -> list[tuple[Row, Row]]:
    """Return the samples that both have; scores at two sizes do not compare."""

    def key(row: Row) -> tuple[Any, ...]:
        return row["dataset"], row["protocol"], row["height"], row["width"], *key_of(row)

    theirs = {key(row): row for row in others}
    return [(row, theirs[key(row)]) for row in rows if key(row) in theirs]


def _difference_sections(named: Mapping[str, Run]) -> list[Section]:
    """Set each run against the first, the later minus the earlier."""
    (letter, first), *others = named.items()
    pairs = {}
    for other, run in others:
        for name, earlier, later in _paired(first, run):
            pairs[f"{name}, {other}" if others[1:] else name] = (later, earlier)
    folded = {table.title: table for table in difference_tables(pairs, MORE, "Method")}
    sections = []
    for table in difference_tables(pairs, MAIN, "Method"):
        blocks: list[Block] = [table.untitled]
        if table.title in folded:
            rest = folded[table.title].untitled
            blocks.append(Fold("By other protocols, and calibration", [rest]))
        minus = others[0][0] if len(others) == 1 else "Each"
        sections.append(Section(f"{minus} minus {letter}, {table.title}", blocks))
    return sections


def differing_settings(manifests: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """List the leaves of manifests that differ: the name, and the value in each.

    Of the data of more than :data:`SCENES` scenes that differ alike the first ones are listed.
    """
    flat = [dict(flatten({k: v for k, v in m.items() if k != "data"})) for m in manifests]
    lines = _differences(flat)
    data = [manifest.get("data", {}) for manifest in manifests]
    by_leaf: dict[str, list[list[str]]] = {}
    for scene in dict.fromkeys(name for scenes in data for name in scenes):
        if all(scene in scenes for scenes in data):
            leaves = [{f".{k}": v for k, v in flatten(scenes[scene])} for scenes in data]
        else:
            leaves = [{"": "present"} if scene in scenes else {} for scenes in data]
        for leaf, *values in _differences(leaves):
            by_leaf.setdefault(leaf, []).append([f"data.{scene}{leaf}", *values])
    for leaf, scene_lines in by_leaf.items():
        lines += scene_lines[:SCENES]
        if rest := len(scene_lines[SCENES:]):
            lines.append([f"data of {rest} more scenes{leaf}", *["differs"] * len(manifests)])
    return lines


def _differences(leaves: Sequence[Mapping[str, str]]) -> list[list[str]]:
    names = dict.fromkeys(name for values in leaves for name in values)
    lines = ([name, *(values.get(name, NO_VALUE) for values in leaves)] for name in names)
    return [line for line in lines if len(set(line[1:])) > 1]


@dataclass(frozen=True)
class _Entry:
    """A method of a run with what it was asked, the truth's digest by scene, and its scores."""

    letter: str
    method: str
    asked: frozenset[tuple[str, str, str]]
    truth: Mapping[str, str]
    scores: Mapping[str, Row]
    seconds: float | None

    def is_like(self, other: _Entry) -> bool:
        shared = self.truth.keys() & other.truth.keys()
        same_truth = all(self.truth[scene] == other.truth[scene] for scene in shared)
        return self.asked == other.asked and same_truth


def rank_methods(named: Mapping[str, Run]) -> list[Table]:
    """Rank the methods of runs by the first score of each protocol; equal as printed is equal.

    There is a table for each data set, protocol, size and list of questions; the truth is the same
    where the manifests know it.
    """
    groups: dict[tuple[str, str, str], list[list[_Entry]]] = {}
    for letter, run in named.items():
        for kind, entry in _entries(letter, run):
            same_kind = groups.setdefault(kind, [])
            group = next((group for group in same_kind if group[0].is_like(entry)), None)
            if group is None:
                same_kind.append([entry])
            else:
                group.append(entry)
    order = list(dict.fromkeys(score.protocol for score in (*MAIN, *MORE)))
    return [
        _ranking(kind, group)
        for kind in sorted(groups, key=lambda kind: order.index(kind[1].partition("@")[0]))
        for group in sorted(groups[kind], key=len, reverse=True)
    ]


def _entries(letter: str, run: Run) -> Iterator[tuple[tuple[str, str, str], _Entry]]:
    seconds = {(cost.dataset, cost.method): cost.view_query for cost in run.costs}
    data = run.manifest.get("data", {})
    kinds: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in run.rows:
        size = f"{row['height']} x {row['width']}"
        kinds.setdefault((row["method"], row["dataset"], row["protocol"], size), []).append(row)
    for (method, *kind), rows in kinds.items():
        dataset, protocol, size = kind
        scores = {score["metric"]: score for score in score_table(rows).to_pylist()}
        if not any(score.metric in scores for score in _ranked_scores(protocol)):
            continue
        asked = frozenset(
            key_of(row) for row in rows if any(m.of(row) is not None for m in METRICS)
        )
        digests = {scene: data.get(scene, {}).get("truth") for scene, *_ in asked}
        truth = {scene: digest for scene, digest in digests.items() if digest is not None}
        spent = seconds.get((dataset, method))
        entry = _Entry(letter, method, asked, truth, scores, spent)
        yield (dataset, protocol, size), entry


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
        name = f"{rank}. {entry.method}"
        rows.append([name, entry.letter, *cells, number(entry.seconds, 3)])
    names = [Column(name, is_text=True) for name in ("Method", "Run")]
    scenes = len({scene for scene, *_ in group[0].asked})
    dataset, protocol, size = kind
    title = f"{dataset} by {protocol} at {size}: {scenes} scenes, {len(group[0].asked)} queries"
    return Table.of([*names, *(score.column() for score in shown), "s"], rows, title)


def _costs_table(runs: Sequence[Run]) -> Table:
    """Set seconds, memory and machines side by side."""
    costs = [{(cost.dataset, cost.method): cost for cost in run.costs} for run in runs]
    rows = []
    for key in costs[0]:
        for name, (title, unit, digits) in COSTS.items():
            values = [getattr(by_key.get(key), name, None) for by_key in costs]
            if None not in values:
                cells = [number(value, digits, unit) for value in values]
                rows.append([f"{', '.join(key)}: {title}", *cells])
    stages = [run.times.get("seconds_by_stage", {}) for run in runs]
    for stage in (name for name in stages[0] if all(name in seconds for seconds in stages)):
        seconds = (number(by_stage[stage], 2) for by_stage in stages)
        rows.append([f"{stage} of all scenes, s", *seconds])
    for name in ("machine", "processor", "workers"):
        rows.append([name, *(run.times.get("host", {}).get(name) for run in runs)])
    note = (
        "Medians over scenes, each of when it was made. On two machines, or beside other work, "
        "they do not compare."
    )
    return Table.of(["", *ascii_uppercase[: len(runs)]], rows, notes=[note])


def _changes_table(first: Run, second: Run) -> Table | None:
    """List the most changed queries of the first method of both, what became worse first."""
    name, earlier, later = next(_paired(first, second), ("", [], []))
    changed = [
        (row, other["iou"], other["iou"] - row["iou"])
        for row, other in _aligned(of_first_protocol(earlier), of_first_protocol(later))
        if None not in (row["iou"], other["iou"]) and row["iou"] != other["iou"]
    ]
    if not changed:
        return None
    changed = sorted(changed, key=lambda one: -abs(one[2]))[:CHANGED]
    rows = [
        [
            row["query"],
            f"{row['scene']}, {row['frame']}",
            number(row["iou"], 3),
            number(after, 3),
            mask_place(row).as_posix(),
        ]
        for row, after, _ in sorted(changed, key=lambda one: one[2])
    ]
    place, mask = (Column(n, is_text=True) for n in ("Scene and frame", "Mask, in predictions/"))
    note = f"By {escape(name)}, {escape(earlier[0]['protocol'])}."
    return Table.of(["Query", place, "IoU of A", "IoU of B", mask], rows, notes=[note])
