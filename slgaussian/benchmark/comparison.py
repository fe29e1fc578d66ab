"""Two reports side by side: what differs in how they were made, and by how much in the scores.

Only what both were asked counts: the same query of the same frame, by the same version of a
protocol.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.costs import Cost, costs_of
from slgaussian.benchmark.outputs import mask_place
from slgaussian.benchmark.rendering import data_uri, flatten, template
from slgaussian.benchmark.score_tables import MAIN, MORE, Table, difference_tables
from slgaussian.benchmark.showcase import key_of, leading
from slgaussian.benchmark.statistics import LEAST, LEVEL
from slgaussian.errors import InputError
from slgaussian.formats import strict_json
from slgaussian.formats.images import read_mask
from slgaussian.storage.specs import load_spec
from slgaussian.storage.tables import read_table

Row = Mapping[str, Any]

CHANGED = 8
"""Queries that are shown, those whose IoU changed most."""

WIDTH = 300
"""Pixels, at most, of the width of a picture of two masks."""

BOTH, FIRST, SECOND, NEITHER = (236, 239, 244), (230, 126, 34), (0, 114, 178), (29, 35, 48)
"""Colours of the pixels of two masks: in both, in that of the first report alone, of the second."""


COSTS = {
    "prepare": ("to prepare a scene, s", 1.0, 4),
    "view_query": ("a query in a new view, s", 1.0, 4),
    "further_query": ("one more in it, s", 1.0, 4),
    "grown": ("memory, MB", 1e6, 0),
}
"""What is compared of each :class:`Cost`: in words, its unit, and digits."""

EXPECTED = "expected a folder that benchmark, run or demo wrote"

SCENES = 3
"""Scenes whose data differ that are named one by one, at most."""

HOST = "machine", "processor", "workers"
"""What is said of where both were measured."""


@dataclass(frozen=True)
class Made:
    """What a run left in a folder: samples, manifest, times and costs, empty if there are none."""

    folder: Path
    rows: list[Row]
    manifest: Mapping[str, Any]
    times: Mapping[str, Any] = field(default_factory=dict)
    costs: Sequence[Cost] = ()

    @property
    def by_method(self) -> dict[str, list[Row]]:
        """The samples of each method, ours first."""
        found: dict[str, list[Row]] = {}
        for row in self.rows:
            found.setdefault(row["method"], []).append(row)
        return found


@dataclass(frozen=True)
class Change:
    """A query and its IoU in both reports; ``picture`` is of both masks, where they are there."""

    method: str
    row: Row
    first: float
    second: float
    picture: np.ndarray | None


@dataclass(frozen=True)
class Reports:
    """Two reports compared, the second minus the first.

    Attributes
    ----------
    first, second : str
        Their folders.
    said : str
        One sentence about what they have in common.
    settings : list of (name, first, second)
        What differs in how they were made.
    tables, more : list of Table
        Paired differences by data set, a line a method: of the main scores, and of the others.
    changes : list of Change
        Most changed first; what became worse before what became better.
    costs : list of (name, first, second)
        Seconds and memory of both, and where they were measured.
    """

    first: str
    second: str
    said: str
    settings: list[tuple[str, str, str]]
    tables: list[Table]
    more: list[Table]
    changes: list[Change]
    costs: list[tuple[str, str, str]]


def read_made(folder: str | Path) -> Made:
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
    table = _table("samples", file)
    manifest, times = (_mapping(folder / name) for name in ("manifest.json", "times.json"))
    costs = folder / "times.parquet"
    rows = _table("times", costs).to_pylist() if costs.is_file() else []
    return Made(folder, table.to_pylist(), manifest, times, costs_of(rows))


def compare_reports(first: Made, second: Made) -> Reports:
    """Set what two runs left against each other."""
    pairs = _pairs(first, second)
    gains = {name: (later, earlier) for name, (earlier, later) in pairs.items()}
    return Reports(
        str(first.folder),
        str(second.folder),
        _said(first, second, pairs),
        differing_settings(first.manifest, second.manifest),
        difference_tables(gains, MAIN),
        difference_tables(gains, MORE),
        _changes(first.folder, second.folder, pairs),
        _costs(first, second),
    )


def render_comparison(found: Reports) -> tuple[str, str]:
    """The comparison as an HTML page, without network and script, and as Markdown."""
    pictures = [
        None if change.picture is None else data_uri(change.picture, WIDTH)
        for change in found.changes
    ]
    shown = {"found": found, "least": LEAST, "level": LEVEL}
    page = template("comparison.html.j2").render(**shown, pictures=pictures)
    return page, template("comparison.md.j2").render(**shown)


def mask_change(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Two masks bool [H, W] in one picture uint8 [H, W, 3]."""
    colors = np.array([NEITHER, FIRST, SECOND, BOTH], np.uint8)
    return colors[first.astype(int) + 2 * second.astype(int)]


def _table(spec: str, file: Path) -> pa.Table:
    try:
        table = read_table(file)
    except (OSError, ValueError, pa.ArrowException) as error:
        why = " ".join(str(error).split())
        raise InputError(f"{file}: cannot be read ({why}); {EXPECTED}") from error
    load_spec(spec).check_table(table, str(file))
    return table


def _mapping(file: Path) -> dict[str, Any]:
    try:
        content = strict_json.parse(file.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}); run the benchmark again") from error
    if not isinstance(content, dict):
        raise InputError(f"{file}: found no JSON object; run the benchmark again")
    return content


def _pairs(first: Made, second: Made) -> dict[str, tuple[list[Row], list[Row]]]:
    """The samples of each method that both have; if none, those of their own methods."""
    earlier, later = first.by_method, second.by_method
    shared = {name: (earlier[name], later[name]) for name in earlier if name in later}
    if not shared and earlier and later:
        (name, rows), (other, others) = next(iter(earlier.items())), next(iter(later.items()))
        shared = {f"{other} − {name}": (rows, others)}
    return {name: pair for name, pair in shared.items() if _keys(pair[0]) & _keys(pair[1])}


def _said(
    first: Made, second: Made, pairs: Mapping[str, tuple[Sequence[Row], Sequence[Row]]]
) -> str:
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
        f"{count} more in {made.folder}"
        for made, count in zip((first, second), more, strict=True)
        if count
    ]
    return "; ".join([text, *alone])


def _described(made: Made) -> str:
    if not made.rows:
        return "no samples"
    scenes = list(dict.fromkeys(row["scene"] for row in made.rows))
    sets = dict.fromkeys(row["dataset"] for row in made.rows)
    listed = ", ".join(scenes[:3]) + (" ..." if len(scenes) > 3 else "")
    return f"{len(scenes)} scene(s) of {', '.join(sets)} ({listed})"


def _key(row: Row) -> tuple[Any, ...]:
    """What two samples must share to be compared; scores at two sizes do not compare."""
    return row["dataset"], row["protocol"], row["height"], row["width"], *key_of(row)


def _keys(rows: Sequence[Row]) -> set[tuple[Any, ...]]:
    return set(map(_key, rows))


def _aligned(rows: Sequence[Row], others: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """The samples that both have, in one order."""
    theirs = {_key(row): row for row in others}
    mine = [row for row in rows if _key(row) in theirs]
    return mine, [theirs[_key(row)] for row in mine]


def differing_settings(
    first: Mapping[str, Any], second: Mapping[str, Any]
) -> list[tuple[str, str, str]]:
    """List the leaves of two manifests that differ.

    Those of the data in a line a scene; of more than :data:`SCENES` scenes in one for all.
    """
    if not first or not second:
        return []
    data = [dict(made.get("data", {})) for made in (first, second)]
    one, other = (
        dict(flatten({k: v for k, v in made.items() if k not in ("data", "methods")}))
        for made in (first, second)
    )
    methods = [made.get("methods", {}) for made in (first, second)]
    for own, theirs, values in ((*methods, one), (*methods[::-1], other)):
        values["methods"] = "; ".join(k for k in own if own[k] != theirs.get(k)) or "–"
    found = [
        (name, one.get(name, "–"), other.get(name, "–"))
        for name in dict.fromkeys([*one, *other])
        if one.get(name) != other.get(name)
    ]
    differing: dict[str, list[tuple[str, str, str]]] = {}
    alone = []
    for scene in dict.fromkeys([*data[0], *data[1]]):
        if scene not in data[0] or scene not in data[1]:
            before, after = ("present" if scene in own else "–" for own in data)
            alone.append((f"data.{scene}", before, after))
            continue
        mine, theirs = (dict(flatten(own[scene])) for own in data)
        for leaf in dict.fromkeys([*mine, *theirs]):
            if mine.get(leaf) != theirs.get(leaf):
                told = scene, mine.get(leaf, "–"), theirs.get(leaf, "–")
                differing.setdefault(leaf, []).append(told)
    for leaf, scenes in differing.items():
        if len(scenes) <= SCENES:
            found += [(f"data.{scene}.{leaf}", a, b) for scene, a, b in scenes]
        else:
            scene, a, b = scenes[0]
            more = f" of {scene}, and others of {len(scenes) - 1} more scenes"
            found.append((f"data.*.{leaf}", _short(a) + more, _short(b) + more))
    return found + alone


def _short(value: str) -> str:
    """The beginning of a digest."""
    return value if len(value) <= 16 else f"{value[:12]}…"


def _costs(first: Made, second: Made) -> list[tuple[str, str, str]]:
    """What both cost, side by side; nothing where one has no times."""
    if not first.times or not second.times:
        return []
    found = []
    by_method = {(cost.dataset, cost.method): cost for cost in second.costs}
    for cost in first.costs:
        other = by_method.get((cost.dataset, cost.method))
        for key, (what, unit, digits) in COSTS.items():
            one, another = getattr(cost, key), getattr(other, key, None)
            if one is not None and another is not None:
                shown = f"{one / unit:.{digits}f}", f"{another / unit:.{digits}f}"
                found.append((f"{cost.dataset}, {cost.method}: {what}", *shown))
    both = first.times, second.times
    stages = [times.get("seconds_by_stage", {}) for times in both]
    for stage in (name for name in stages[0] if name in stages[1]):
        seconds, others = (f"{one[stage]:.2f}" for one in stages)
        found.append((f"{stage} of all scenes, s", seconds, others))
    for what in HOST:
        here, there = (str(times.get("host", {}).get(what, "–")) for times in both)
        found.append((what, here, there))
    return found


def _changes(
    first: Path, second: Path, pairs: Mapping[str, tuple[Sequence[Row], Sequence[Row]]]
) -> list[Change]:
    """The most changed queries of the first method that both have."""
    if not pairs:
        return []
    name, (earlier, later) = next(iter(pairs.items()))
    known = [
        (row, other, other["iou"] - row["iou"])
        for row, other in zip(*_aligned(leading(earlier), leading(later)), strict=True)
        if None not in (row["iou"], other["iou"])
    ]
    known = sorted((k for k in known if k[2]), key=lambda k: -abs(k[2]))[:CHANGED]
    changes = []
    for row, other, _ in sorted(known, key=lambda k: k[2]):
        before, after = _mask(first, row), _mask(second, other)
        picture = None
        if before is not None and after is not None and before.shape == after.shape:
            picture = mask_change(before, after)
        changes.append(Change(name, row, row["iou"], other["iou"], picture))
    return changes


def _mask(folder: Path, row: Row) -> np.ndarray | None:
    """The mask of a row; None if it is not there."""
    try:
        data = (folder / "predictions" / mask_place(row)).read_bytes()
        return read_mask(io.BytesIO(data))
    except (OSError, InputError):
        return None
