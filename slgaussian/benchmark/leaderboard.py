"""Methods of several runs, ranked: what different machines, versions and people left in folders.

A table is of one data set, one version of a protocol and one judging size. Only what was asked the
same is ranked together: the same queries of the same frames of the same scenes, with the same
truth where it is known. What was asked something else stands apart, with a rank of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from string import ascii_uppercase
from typing import Any

from slgaussian.benchmark.comparison import Made, read_made
from slgaussian.benchmark.costs import Cost
from slgaussian.benchmark.rendering import flatten, template
from slgaussian.benchmark.score_tables import MAIN, MORE, NOTHING, Cell, Column, about, conditions
from slgaussian.benchmark.scores import METRICS, score_table
from slgaussian.benchmark.statistics import LEVEL
from slgaussian.errors import InputError

Row = Mapping[str, Any]
Asked = frozenset[tuple[str, str, str]]
"""Scene, frame and query of everything that was scored."""

NAMED = 3
"""So many settings, or files of the data, are named where runs differ; all stand below."""

UNKNOWN = "not known"

DIFFERS = {
    "settings": ("settings.", "seed"),
    "weights": ("weights.",),
    "stages of other versions": ("slgaussian", "stages.", "protocols"),
    "other packages or kernels": ("packages.", "kernels."),
}
"""What is said of a run that differs, and which leaves of the manifest it is said by. The index is
not among them: what was asked decides who is ranked together."""


@dataclass(frozen=True)
class Folder:
    """A folder that a run left, and what is known of the run.

    Attributes
    ----------
    letter, path : str
        How it is called here, and where it is.
    version, machine : str
        Of the program, and where it ran; ``not known`` without a manifest or times.
    settings : {name: text}
        The leaves of its manifest but for the data.
    data : {scene: {name: text}}
        Files of photographs and labels with their digests, and the digest of the truth.
    """

    letter: str
    path: str
    version: str
    machine: str
    settings: Mapping[str, str]
    data: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class Entry:
    """A method of a run, in one table.

    Attributes
    ----------
    rank : int
        Among those that were asked the same; equal where the first score reads the same.
    method, about : str
    folder : Folder
    cells : tuple of Cell
        A score for each column, with its interval.
    cost : Cost or None
        Seconds and memory, where they were measured.
    by : str
        What its scores go by: threshold, temperature, phrases.
    marks : tuple of str
        What differs from the first of those that were asked the same.
    """

    rank: int
    method: str
    about: str
    folder: Folder
    cells: tuple[Cell, ...]
    cost: Cost | None
    by: str
    marks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ranking:
    """Entries that were asked the same, best first, and what that was in a sentence."""

    said: str
    entries: tuple[Entry, ...]


@dataclass(frozen=True)
class Board:
    """A data set by one protocol at one size; the first ranking has the most entries."""

    dataset: str
    protocol: str
    size: str
    columns: tuple[Column, ...]
    rankings: tuple[Ranking, ...]


@dataclass(frozen=True)
class Leaderboard:
    """The boards of some folders, and what differs between those: name and a text for each."""

    folders: tuple[Folder, ...]
    boards: tuple[Board, ...]
    differences: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True)
class _Candidate:
    """A method of a folder by one protocol, before it is ranked."""

    made: Folder
    dataset: str
    protocol: str
    size: str
    asked: Asked
    truth: Mapping[str, str]
    scores: Mapping[str, Row]
    cost: Cost | None

    @property
    def by(self) -> str:
        return conditions(next(iter(self.scores.values())))


def read_leaderboard(folders: Sequence[str | Path]) -> Leaderboard:
    """Rank what runs left in ``folders``, in the order of the protocols.

    Raises
    ------
    InputError
        If a folder is given twice, is none that a run left, or has no scored sample.
    """
    known: dict[Path, Path] = {}
    for place in map(Path, folders):
        if place.resolve() in known:
            raise InputError(f"leaderboard: {place} is given twice; give each folder once")
        known[place.resolve()] = place
    made = [read_made(place) for place in known.values()]
    told = [_folder(_letter(number), one) for number, one in enumerate(made)]
    candidates = []
    for folder, one in zip(told, made, strict=True):
        own = _candidates(folder, one)
        if not own:
            raise InputError(
                f"{one.folder}: found no scored sample, expected what benchmark or score wrote "
                "with labels; leave this folder out"
            )
        candidates += own
    groups: dict[tuple[str, str, str], list[_Candidate]] = {}
    for candidate in candidates:
        key = candidate.dataset, candidate.protocol, candidate.size
        groups.setdefault(key, []).append(candidate)
    order = list(dict.fromkeys(column.protocol for column in (*MAIN, *MORE)))
    ordered = sorted(groups.items(), key=lambda item: order.index(_name(item[0][1])))
    boards = tuple(_board(*key, own) for key, own in ordered)
    return Leaderboard(tuple(told), boards, _differences(told))


def render_leaderboard(found: Leaderboard) -> tuple[str, str]:
    """The leaderboard as an HTML page, which needs no network, and as Markdown."""
    shown = {"found": found, "level": LEVEL, "terms": _terms(found)}
    forms = (template(f"leaderboard.{kind}.j2").render(**shown) for kind in ("html", "md"))
    page, markdown = forms
    return page, markdown


def _terms(found: Leaderboard) -> dict[str, str]:
    """What stands in the tables, by the name it has there."""
    columns = [column for board in found.boards for column in board.columns]
    terms: dict[str, str] = {}
    for column in columns:  # what later protocols say refers to those before
        terms.setdefault(column.title, column.help)
    return terms | {
        "range": f"below a score, where {100 * LEVEL:.0f} % of the means lie if scenes, or the "
        "places that they show, are drawn anew",
        "s": "seconds of a query in a view that was not seen before, with rendering; the median, "
        "on the machine of that row",
        "MB": "the most memory that a scene took beyond what the program holds anyway",
        "≠": "differs in this from the first run in the same ranking",
    }


def _letter(number: int) -> str:
    """A, B, ..., Z, AA, AB, ..."""
    more, last = divmod(number, len(ascii_uppercase))
    return (_letter(more - 1) if more else "") + ascii_uppercase[last]


def _name(protocol: str) -> str:
    return protocol.partition("@")[0]


def _folder(letter: str, made: Made) -> Folder:
    manifest = made.manifest
    rest = {key: value for key, value in manifest.items() if key not in ("data", "methods")}
    data = {}
    for scene, entry in manifest.get("data", {}).items():
        held = {key: entry[key] for key in ("files", "labels", "truth") if key in entry}
        data[scene] = dict(flatten(held))
    return Folder(
        letter,
        str(made.folder),
        str(manifest.get("slgaussian", UNKNOWN)),
        str(made.times.get("host", {}).get("processor", UNKNOWN)),
        dict(flatten(rest)),
        data,
    )


def _candidates(folder: Folder, made: Made) -> list[_Candidate]:
    costs = {(cost.dataset, cost.method): cost for cost in made.costs}
    found = []
    for method, rows in made.by_method.items():
        groups: dict[tuple[str, str, str], list[Row]] = {}
        for row in rows:
            size = f"{row['height']} x {row['width']}"
            groups.setdefault((row["dataset"], row["protocol"], size), []).append(row)
        for (dataset, protocol, size), own in groups.items():
            scores = {
                score["metric"]: score
                for score in score_table(own).to_pylist()
                if score["metric"] in {column.metric for column in _columns(protocol)}
            }
            if not scores:
                continue
            asked = frozenset(
                (row["scene"], row["frame"], row["query"])
                for row in own
                if any(metric.of(row) is not None for metric in METRICS)
            )
            truth = {
                scene: folder.data[scene]["truth"]
                for scene in {scene for scene, *_ in asked}
                if "truth" in folder.data.get(scene, {})
            }
            cost = costs.get((dataset, method))
            found.append(_Candidate(folder, dataset, protocol, size, asked, truth, scores, cost))
    return found


def _columns(protocol: str) -> list[Column]:
    """The scores of a protocol that are the better the greater."""
    return [one for one in (*MAIN, *MORE) if one.protocol == _name(protocol) and one.sign > 0]


def _board(dataset: str, protocol: str, size: str, candidates: Sequence[_Candidate]) -> Board:
    columns = tuple(
        column
        for column in _columns(protocol)
        if any(column.metric in candidate.scores for candidate in candidates)
    )
    groups: list[list[_Candidate]] = []
    for candidate in candidates:
        for group in groups:
            if _same(group[0], candidate):
                group.append(candidate)
                break
        else:
            groups.append([candidate])
    groups.sort(key=lambda group: (-len(group), -len(group[0].asked)))
    rankings = tuple(_ranking(group, columns, groups[0][0]) for group in groups)
    return Board(dataset, protocol, size, columns, rankings)


def _same(one: _Candidate, other: _Candidate) -> bool:
    """Whether both were asked the same, and no truth is known to differ."""
    shared = one.truth.keys() & other.truth.keys()
    return one.asked == other.asked and all(one.truth[k] == other.truth[k] for k in shared)


def _ranking(group: Sequence[_Candidate], columns: Sequence[Column], most: _Candidate) -> Ranking:
    first = columns[0]

    def value(candidate: _Candidate) -> float:
        score = candidate.scores.get(first.metric)
        return -1.0 if score is None else round(score["value"], first.digits)

    values = [value(candidate) for candidate in group]
    ranked = sorted(group, key=lambda candidate: -value(candidate))
    entries = []
    for candidate in ranked:
        method = str(next(iter(candidate.scores.values()))["method"])
        entries.append(
            Entry(
                rank=1 + sum(other > value(candidate) for other in values),
                method=method,
                about=about(method),
                folder=candidate.made,
                cells=tuple(_cell(candidate.scores.get(c.metric), c) for c in columns),
                cost=candidate.cost,
                by=candidate.by,
                marks=_marks(candidate, group[0]),
            )
        )
    return Ranking(_said(group[0], most), tuple(_with_best(entries)))


def _with_best(entries: Sequence[Entry]) -> Sequence[Entry]:
    """The entries, with the best of each column marked; of one alone nothing is best."""
    if len(entries) < 2:
        return entries
    columns = zip(*(entry.cells for entry in entries), strict=True)
    best = [max((c.value for c in cells if c != NOTHING), default="") for cells in columns]
    return [
        replace(
            entry,
            cells=tuple(
                replace(cell, mark="best") if cell.value == top else cell
                for cell, top in zip(entry.cells, best, strict=True)
            ),
        )
        for entry in entries
    ]


def _cell(score: Row | None, column: Column) -> Cell:
    if score is None:
        return NOTHING
    ends = score["low"], score["high"]
    interval = "" if None in ends else "–".join(f"{end:.{column.digits}f}" for end in ends)
    return Cell(f"{score['value']:.{column.digits}f}", interval, "", score["note"])


def _said(own: _Candidate, most: _Candidate) -> str:
    """What was asked, and how that differs from what most were asked."""
    scenes = {scene for scene, *_ in own.asked}
    told = f"{_counted(len(scenes), 'scene')}, {_counted(len(own.asked), 'query', 'queries')}"
    if own is most:
        return told
    others = {scene for scene, *_ in most.asked}
    shared = len(own.asked & most.asked)
    if own.asked == most.asked:
        differ = [
            scene
            for scene in sorted(own.truth.keys() & most.truth.keys())
            if own.truth[scene] != most.truth[scene]
        ]
        why = f"the same names, but another truth of {_few(differ)}"
    elif shared:
        why = f"{shared} of the queries and {len(scenes & others)} of the scenes are those above"
    else:
        why = "nothing that was asked above"
    return f"{told}: {why}; not to be ranked with those above"


def _marks(own: _Candidate, first: _Candidate) -> tuple[str, ...]:
    """What a run differs in from the first that was asked the same."""
    marks = []
    if own.by != first.by:
        parts = [part for part in own.by.split(", ") if part not in first.by.split(", ")]
        marks.append(f"goes by {', '.join(parts) or own.by}")
    one, other = first.made, own.made
    if one is other:
        return tuple(marks)
    scenes = sorted({scene for scene, *_ in own.asked})
    if not other.settings or not one.settings:
        marks.append("settings and data are not known of one of both")
        return tuple(marks)
    files = [
        f"{scene}: {name.partition('.')[2]}"
        for scene in scenes
        for name in dict.fromkeys([*one.data.get(scene, {}), *other.data.get(scene, {})])
        if one.data.get(scene, {}).get(name) != other.data.get(scene, {}).get(name)
    ]
    if files:
        marks.append(f"data: {_few(files)}")
    names = [
        name
        for name in dict.fromkeys([*one.settings, *other.settings])
        if one.settings.get(name) != other.settings.get(name)
    ]
    for title, starts in DIFFERS.items():
        own_names = [name for name in names if name.startswith(starts)]
        told = [name.partition(".")[2] or name for name in own_names]
        if title == "settings":
            told = [
                f"{short} {other.settings.get(name, '–')} (not {one.settings.get(name, '–')})"
                for short, name in zip(told, own_names, strict=True)
            ]
        if told:
            marks.append(f"{title}: {_few(told)}")
    return tuple(marks)


def _differences(folders: Sequence[Folder]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """What of settings and versions is not one in all folders that have a manifest."""
    known = [folder for folder in folders if folder.settings]
    names = dict.fromkeys(name for folder in known for name in folder.settings)
    return tuple(
        (name, tuple(folder.settings.get(name, "–") for folder in folders))
        for name in names
        if len({folder.settings.get(name) for folder in known}) > 1
    )


def _counted(count: int, one: str, many: str = "") -> str:
    return f"{count} {one if count == 1 else many or one + 's'}"


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
