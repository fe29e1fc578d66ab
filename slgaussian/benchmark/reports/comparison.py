"""Runs compared: how they were made, by how much scores differ, and methods ranked.

Only what was asked the same counts: the same query of the same frame, by the same version of a
protocol, judged at the same size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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
from slgaussian.benchmark.reports.runs import Run, rank_methods
from slgaussian.benchmark.reports.score_tables import (
    MAIN,
    MORE,
    difference_tables,
)
from slgaussian.benchmark.scores import key_of, of_first_protocol
from slgaussian.errors import InputError

Row = Mapping[str, Any]
Pairs = Mapping[str, tuple[Sequence[Row], Sequence[Row]]]

CHANGED = 8
"""Queries that are shown, those whose IoU changed most."""

COSTS = {
    "prepare": ("to prepare a scene, s", 1.0, 4),
    "view_query": ("a query in a new view, s", 1.0, 4),
    "further_query": ("one more in it, s", 1.0, 4),
    "grown": ("memory, MB", 1e6, 0),
}
"""Of each :class:`Cost` what is compared: in words, its unit, and digits."""

SCENES = 3
"""Scenes whose data differ that are named one by one, at most."""


def compare_runs(runs: Sequence[Run]) -> Report:
    """Compare two runs, the second minus the first, or rank the methods of more.

    Raises
    ------
    InputError
        If there are fewer than two, or of more than two one is given twice or has no score.
    """
    if len(runs) < 2:
        raise InputError(f"compare: found {len(runs)} run, expected two or more")
    first, *others = runs
    if len(runs) > 2:
        sections = [Section(t.title, [_untitled(t)]) for t in rank_methods(runs)]
        opening = "Only what was asked the same is in one table. Intervals hold 95% of the means "
        opening += "if scenes are drawn anew; s: median seconds of a query in a new view."
        for run in others:
            if settings := differing_settings(first.manifest, run.manifest):
                title = f"{run.folder} differs from {first.folder}"
                sections.append(
                    Section(title, [_settings_table(settings, "first run", "this one")])
                )
        return Report("Runs ranked", [Prose(opening)], sections)
    second = others[0]
    pairs = _pairs(first, second)
    opening = f"A: {escape(first.folder)}. B: {escape(second.folder)}. Differences are B minus A."
    sections = [_made_section(first, second)]
    gains = {name: (later, earlier) for name, (earlier, later) in pairs.items()}
    more = {table.title: table for table in difference_tables(gains, MORE, "Method")}
    for table in difference_tables(gains, MAIN, "Method"):
        blocks: list[Block] = [_untitled(table)]
        if table.title in more:
            other = _untitled(more[table.title])
            blocks.append(Fold("By other protocols, and calibration", [other]))
        sections.append(Section(f"B minus A, {table.title}", blocks))
    if costs := _costs_table(first, second):
        sections.append(Section("What they cost", [costs]))
    if changes := _changes_table(pairs):
        sections.append(Section("IoU that changed most", [changes]))
    summary = escape(_summary(first, second, pairs))
    return Report("Two runs", [Prose(opening), Prose(f"{summary}.")], sections)


def _untitled(table: Table) -> Table:
    return Table(table.columns, table.lines, "", table.notes)


def _pairs(first: Run, second: Run) -> Pairs:
    """Pair the samples of each method that both have; if none, those of their own methods."""
    earlier, later = first.by_method, second.by_method
    shared = {name: (earlier[name], later[name]) for name in earlier if name in later}
    if not shared and earlier and later:
        (name, rows), (other, others) = next(iter(earlier.items())), next(iter(later.items()))
        shared = {f"{other} − {name}": (rows, others)}
    return {name: pair for name, pair in shared.items() if _aligned(*pair)[0]}


def _summary(first: Run, second: Run, pairs: Pairs) -> str:
    """Describe in a sentence what both have in common."""
    if not pairs:
        return (
            f"nothing to compare: {first.folder} has {_described(first)}, {second.folder} has "
            f"{_described(second)}, and no query of the same frame, judged at the same size, is in "
            "both"
        )
    total = same = 0
    more = [0, 0]
    for earlier, later in pairs.values():
        mine, theirs = _aligned(earlier, later)
        total += len(mine)
        same += sum(
            {**a, "method": ""} == {**b, "method": ""} for a, b in zip(mine, theirs, strict=True)
        )
        more[0] += len(earlier) - len(mine)
        more[1] += len(later) - len(mine)
    text = f"{total} samples of {len(pairs)} method{'s' if len(pairs) > 1 else ''} are in both"
    text += ", and all are the same" if same == total else f", {total - same} of them changed"
    alone = [
        f"{count} more in {run.folder}"
        for run, count in zip((first, second), more, strict=True)
        if count
    ]
    return "; ".join([text, *alone])


def _described(run: Run) -> str:
    if not run.rows:
        return "no samples"
    scenes = list(dict.fromkeys(row["scene"] for row in run.rows))
    sets = dict.fromkeys(row["dataset"] for row in run.rows)
    listed = ", ".join(scenes[:3]) + (" ..." if len(scenes) > 3 else "")
    return f"{len(scenes)} scene(s) of {', '.join(sets)} ({listed})"


def _aligned(rows: Sequence[Row], others: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Return the samples that both have, in one order; scores at two sizes do not compare."""

    def key(row: Row) -> tuple[Any, ...]:
        return row["dataset"], row["protocol"], row["height"], row["width"], *key_of(row)

    theirs = {key(row): row for row in others}
    mine = [row for row in rows if key(row) in theirs]
    return mine, [theirs[key(row)] for row in mine]


def _made_section(first: Run, second: Run) -> Section:
    settings = differing_settings(first.manifest, second.manifest)
    if not settings:
        note = Prose("No setting, version or data is known to differ.")
        return Section("How they were made", [note])
    return Section("How they were made", [_settings_table(settings, "A", "B")])


def _settings_table(settings: Sequence[tuple[str, str, str]], first: str, second: str) -> Table:
    heads = [Column(name, is_text=True) for name in ("what differs", first, second)]
    return Table.of(heads, settings)


def differing_settings(
    first: Mapping[str, Any], second: Mapping[str, Any]
) -> list[tuple[str, str, str]]:
    """List the leaves of two manifests that differ.

    Those of the data in a line a scene; of more than :data:`SCENES` scenes in one for all.
    """
    if not first or not second:
        return []
    data = [dict(run.get("data", {})) for run in (first, second)]
    one, other = (
        dict(flatten({k: v for k, v in run.items() if k not in ("data", "methods")}))
        for run in (first, second)
    )
    methods = [run.get("methods", {}) for run in (first, second)]
    for mine, theirs, values in ((*methods, one), (*methods[::-1], other)):
        changed = (name for name in mine if mine[name] != theirs.get(name))
        values["methods"] = "; ".join(changed) or NO_VALUE
    found = _differences(one, other)
    differing: dict[str, list[tuple[str, str, str]]] = {}
    alone = []
    for scene in dict.fromkeys([*data[0], *data[1]]):
        if scene not in data[0] or scene not in data[1]:
            before, after = ("present" if scene in of else NO_VALUE for of in data)
            alone.append((f"data.{scene}", before, after))
            continue
        for leaf, before, after in _differences(*(dict(flatten(of[scene])) for of in data)):
            differing.setdefault(leaf, []).append((scene, before, after))
    for leaf, scenes in differing.items():
        if len(scenes) <= SCENES:
            found += [(f"data.{scene}.{leaf}", a, b) for scene, a, b in scenes]
        else:
            scene, *ends = scenes[0]
            more = f" of {scene}, and others of {len(scenes) - 1} more scenes"
            a, b = (end if len(end) <= 16 else f"{end[:12]}…" for end in ends)
            found.append((f"data.*.{leaf}", a + more, b + more))
    return found + alone


def _differences(one: Mapping[str, str], other: Mapping[str, str]) -> list[tuple[str, str, str]]:
    return [
        (name, one.get(name, NO_VALUE), other.get(name, NO_VALUE))
        for name in dict.fromkeys([*one, *other])
        if one.get(name) != other.get(name)
    ]


def _costs_table(first: Run, second: Run) -> Table | None:
    """Set seconds, memory and machines of both side by side; None where one has no times."""
    if not first.times or not second.times:
        return None
    rows = []
    by_method = {(cost.dataset, cost.method): cost for cost in second.costs}
    for cost in first.costs:
        other = by_method.get((cost.dataset, cost.method))
        for name, (title, unit, digits) in COSTS.items():
            values = getattr(cost, name), getattr(other, name, None)
            if None not in values:
                cells = [number(value, digits, unit) for value in values]
                rows.append([f"{cost.dataset}, {cost.method}: {title}", *cells])
    both = first.times, second.times
    stages = [times.get("seconds_by_stage", {}) for times in both]
    for stage in (name for name in stages[0] if name in stages[1]):
        rows.append([f"{stage} of all scenes, s", *(number(own[stage], 2) for own in stages)])
    for name in ("machine", "processor", "workers"):
        rows.append([name, *(times.get("host", {}).get(name) for times in both)])
    note = (
        "Medians over scenes, each of when it was made. On two machines, or beside other work, "
        "they do not compare."
    )
    return Table.of(["", "A", "B"], rows, notes=[note])


def _changes_table(pairs: Pairs) -> Table | None:
    """List the most changed queries of the first method of both, what became worse first."""
    if not pairs:
        return None
    name, (earlier, later) = next(iter(pairs.items()))
    mine, theirs = _aligned(of_first_protocol(earlier), of_first_protocol(later))
    changed = [
        (row, other, other["iou"] - row["iou"])
        for row, other in zip(mine, theirs, strict=True)
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
            number(other["iou"], 3),
            mask_place(row).as_posix(),
        ]
        for row, other, _ in sorted(changed, key=lambda one: one[2])
    ]
    texts = (Column(title, is_text=True) for title in ("Scene and frame", "Mask, in predictions/"))
    place, mask = texts
    note = f"By {escape(name)}, {escape(mine[0]['protocol'])}."
    return Table.of(["Query", place, "IoU of A", "IoU of B", mask], rows, notes=[note])
