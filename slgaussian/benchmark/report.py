"""What a benchmark leaves to look at: one HTML page, and the same numbers as Markdown.

A page opens with a sentence, a few numbers and a scene to look at; then come one table, what was
left out and answered worst, and the rest. All depends on the arguments alone, same results, same
bytes, but for one section, the times, and the seconds and memory beside the first scores.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slgaussian.benchmark import opening, plots, showcase
from slgaussian.benchmark.evaluate import ALONG_THE_WAY, ERROR_TOP, NOT_UNDERSTOOD
from slgaussian.benchmark.outputs import mask_place
from slgaussian.benchmark.paper_tables import paper_tables
from slgaussian.benchmark.rendering import data_uri, flatten, template
from slgaussian.benchmark.score_tables import (
    MAIN,
    MORE,
    Column,
    Table,
    about,
    conditions,
    difference_tables,
    method_tables,
)
from slgaussian.benchmark.scores import reliability, score_table
from slgaussian.benchmark.showcase import Key, key_of
from slgaussian.benchmark.speed_error import tradeoffs
from slgaussian.benchmark.statistics import LEAST, LEVEL
from slgaussian.benchmark.summary import Summary, summarize
from slgaussian.benchmark.timings import Times
from slgaussian.benchmark.verdict import CLAIMED, claims
from slgaussian.datasets.published import Standing
from slgaussian.storage.account import Account

Row = Mapping[str, Any]
Images = Mapping[str, np.ndarray]

FEW = 6
"""Scenes up to which all are shown at once, with large pictures."""

MOST = 30
"""Scenes that get pictures: of more, those answered worst. All are in the tables."""

WIDE, NARROW, TILE = 520, 300, 260
"""Width of pictures of few scenes, of many, and of an answer among those of all methods, pixels."""

SHOWN, ANSWER = 800, 480
"""Width of pictures that open the page, and of the worst and the best answers, pixels."""

SHOWN_QUERIES = 6, 4
"""Queries of a scene that get pictures, of few scenes and of many: the worst and the best."""

SHOWN_TARGETS = 2
"""Target views of a scene that are shown."""

STAND_INS = {
    "iou": ("as it is", ""),
    "threshold_iou": ("threshold", "each query cut where it is best for it"),
    "joined_iou": ("joined", "ids of one thing scored as one"),
    "language_iou": ("language", "whole things named, one for each part of the truth"),
    "pieces_iou": ("pieces", "as many objects named as help"),
    "parted_iou": ("parted", "each view's own pieces, as before association"),
    "mask_iou": ("mask", "the true masks of the two photographs"),
    "geometry_iou": ("geometry", "their true depth"),
}
"""Columns of the spec ``attribution``: what is true from there on, in a word and in a line."""

ACCOUNT_COLUMNS = (
    "Gaussians made", "kept", "share", "mean change", "RMS", "greatest", "depths tried",
    "possible", "code numbers", "replicas computed", "asked", "MB of Gaussians", "MB of bank",
)  # fmt: skip
"""Of the table of what each field is made of."""

SCORE_TERMS = {
    "iou": "the pixels that the answer and the labelled thing have in common, as a share of those "
    "that are in either; 1 is the same mask, 0 is none in common",
    "hit_mask": "share of the answers whose one pixel, where they point, is on the thing",
    "hit_peak": "share of the answers of which any of the most relevant pixels is in the thing's "
    "box",
    "hit_box": "share of the answers whose one pixel is in the thing's box",
    "miou": "all texts of a view compete for each pixel; IoU of what each wins, the mean of all",
    "accuracy": "share of the pixels that have the right text and no other",
}
"""What the scores of the first table mean, by metric, in the order of its columns."""

COST_TERMS = {
    "a query in a new view": "seconds to render a view that was not seen before and to answer "
    "there, the median",
    "memory": "the most that a scene took beyond what the program holds anyway",
    "–": "not measured",
}

NEAR_BEST_TERM = (
    "a text names all objects that fit nearly as well as the one that fits best: their lead over "
    "“object”, “thing” and “stuff” is at least the given share of the best lead"
)

TIMES_HERE = "<!-- how long it took -->"
"""Where :func:`with_times` puts what differs from run to run."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene of a report. Images are read when they are wanted, a scene at a time.

    Attributes
    ----------
    name, dataset : str
    rows : sequence
        Of the spec ``samples``: of our method, then of each of the others.
    metrics : {name: float}
        The ``scene_metrics`` of our result.
    account : Account
        What our field is made of.
    pictures : function giving {name: uint8 [H, W, 3]}
        The pictures of our result.
    truth : function giving {frame: {query: bool [H, W]}}
    masks : function (method) giving {(protocol, frame, query): bool [H, W]}
        What a method found.
    """

    name: str
    dataset: str
    rows: Sequence[Row]
    metrics: Mapping[str, float]
    account: Account
    pictures: Callable[[], Images]
    truth: Callable[[], Mapping[str, Images]]
    masks: Callable[[str], Mapping[tuple[str, str, str], np.ndarray]]


@dataclass(frozen=True)
class Report:
    """A report in both forms, as text."""

    html: str
    markdown: str


def render_report(
    scenes: Sequence[Scene],
    manifest: Mapping[str, Any],
    failures: Sequence[Mapping[str, str]] = (),
    attribution: Sequence[Row] = (),
) -> Report:
    """The report of a run: no network, the same bytes from run to run.

    Parameters
    ----------
    scenes : sequence of Scene
    manifest : mapping
        Versions, settings and data, nested mappings allowed. Of ``data``, by scene, ``published``
        says which published scene it is (the fields of
        :class:`slgaussian.datasets.published.Standing`), and ``cameras`` whether they were given.
    failures : sequence of mapping
        Scenes left out: ``scene``, ``stage``, ``reason`` (the columns of ``failures.parquet``).
    attribution : sequence of mapping
        Rows of the spec ``attribution``: what lost each miss of our method.
    """
    by_method: dict[str, list[Row]] = {}
    for scene in scenes:
        for row in scene.rows:
            by_method.setdefault(row["method"], []).append(row)
    ours, own = next(iter(by_method.items()), ("", []))
    own = showcase.leading(own)
    others = {
        method: [row for row in rows if row["protocol"] == own[0]["protocol"]]
        for method, rows in by_method.items()
        if method != ours
    }
    scores = [score for rows in by_method.values() for score in score_table(rows).to_pylist()]
    ranked = showcase.ranked(own)
    worst = showcase.few_a_scene(ranked, showcase.WORST)
    shown_worst = set(map(key_of, worst))
    best = [row for row in reversed(ranked) if key_of(row) not in shown_worst]
    best = showcase.few_a_scene(best, showcase.BEST)
    told = showcase.telling(own, others, showcase.ALL_METHODS)
    lost_by = {key_of(row): row["lost"] or "" for row in attribution}
    gains = difference_tables(
        {method: (by_method[ours], rows) for method, rows in by_method.items() if method != ours}
    )
    drawn = _Drawn(scenes, own, others, {*shown_worst, *map(key_of, best)}, told, lost_by)
    leading = [score for score in scores if own and score["protocol"] == own[0]["protocol"]]
    main = _main_tables(leading)
    numbers = _key_numbers(scenes, leading, ours)
    paper = paper_tables(
        [row for rows in by_method.values() for row in rows], _published(manifest), ours
    )
    rest = [method for method in by_method if method != ours]
    common = {
        "ours": ours,
        "scenes": [scene.name for scene in scenes],
        "failures": _grouped(failures),
        "left_out": len(failures),
        "counts": _counts(own),
        "missed": [
            (dataset, _counts([row for row in own if row["dataset"] == dataset]))
            for dataset in dict.fromkeys(row["dataset"] for row in own)
        ],
        "by": conditions(own[0]) if own else "",
        "protocol": own[0]["protocol"] if own else "",
        "miss": showcase.MISS,
        "worst": [_card(row, lost_by) for row in worst],
        "best": [_card(row, lost_by) for row in best],
        "attribution": _attribution_tables(attribution),
        "stand_ins": STAND_INS,
        "tables": method_tables(scores, MAIN),
        "more": method_tables(scores, MORE),
        "differences": gains,
        "claims": {table.dataset: claims(table) for table in gains},
        "claimed": CLAIMED.title,
        "told": [_answers(key, own, others) for key in told],
        "summaries": _summaries(scenes),
        "accounts": [(scene.name, *_account_cells(scene.account)) for scene in scenes],
        "account_columns": ACCOUNT_COLUMNS,
        "summary_columns": dict.fromkeys(m for *_, one in _summaries(scenes) for m in one.columns),
        "paper": paper,
        "present": any(table.present or table.notes for table in paper),
        "photographs": _photographs(manifest),
        "unseen": _unseen(manifest),
        "sets": list(dict.fromkeys(scene.dataset for scene in scenes)),
        "others": rest,
        "compared": opening.compared(rest),
        "key_numbers": numbers,
        "number_terms": {title: found[0][1].about for title, found in numbers.items()},
        "main": main,
        "score_terms": _score_terms(main, leading),
        "level": LEVEL,
        "least": LEAST,
        "estimated": _estimated(manifest),
        "manifest": flatten({k: v for k, v in manifest.items() if k != "data"}),
        "data": [(name, flatten(entry)) for name, entry in manifest.get("data", {}).items()],
        "times_here": TIMES_HERE,
    }
    html = template("report.html.j2").render(
        **common,
        pictures=drawn.cards,
        tiles=drawn.tiles,
        parts=drawn.parts,
        exhibits=drawn.exhibits,
        slot=opening.slot,
        few=len(scenes) <= FEW,
        anchors={scene.name: f"scene-{k}" for k, scene in enumerate(scenes)},
        asked=Counter(row["scene"] for row in own),
        plots=_plots(scores, by_method, ours),
        error_top=ERROR_TOP,
    )
    return Report(html, template("report.md.j2").render(**common))


def with_times(
    report: Report,
    times: Times,
    rows: Sequence[Row] = (),
    novel: Sequence[tuple[str, str, float]] = (),
) -> Report:
    """The report of :func:`render_report` with what is true of one run on one machine only.

    ``rows`` of the spec ``samples`` are set against the times; those of the first protocol count.
    ``novel`` has data set, method and PSNR of new views (dB), a scene at a time.
    """
    leading = showcase.leading(rows)
    sizes: dict[str, dict[str, None]] = {}
    for row in leading:
        sizes.setdefault(row["dataset"], {})[f"{row['height']} x {row['width']}"] = None
    scores = [
        score
        for by in dict.fromkeys(row["method"] for row in leading)
        for score in score_table([row for row in leading if row["method"] == by]).to_pylist()
    ]
    shown = {
        "times": times,
        "speeds": times.speeds(),
        "tradeoffs": tradeoffs(scores, {k: tuple(v) for k, v in sizes.items()}, times.costs, novel),
        "claim": times.claim(),
        "whole": sum(cost.seconds for cost in times.stages.values()) or 1.0,
        "host": flatten(times.host),
        "elsewhere": {
            name: count
            for name, count in times.machines.items()
            if name != times.host.get("processor")
        },
        "level": LEVEL,
        "paper_seconds": any(speed.paper is not None for speed in times.speeds()),
    }
    forms = (
        opening.fill(page, times.costs).replace(
            TIMES_HERE, template(f"times.{kind}.j2").render(**shown)
        )
        for kind, page in (("html", report.html), ("md", report.markdown))
    )
    return Report(*forms)


class _Drawn:
    """The pictures of a page, as addresses of themselves; of all scenes, one in memory at a time.

    ``exhibits`` are the scenes that open the page, ``cards`` the chosen answers, ``tiles`` what
    each method found, ``parts`` what the template needs of each scene.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        own: Sequence[Row],
        others: Mapping[str, Sequence[Row]],
        chosen: set[Key],
        told: Sequence[Key],
        lost_by: Mapping[Key, str],
    ) -> None:
        self.lost_by = lost_by
        self.exhibits: list[dict[str, Any]] = []
        self.cards: dict[Key, dict[str, str]] = {}
        self.tiles: dict[Key, dict[str, str]] = {}
        self.parts: list[dict[str, Any]] = []
        few = len(scenes) <= FEW
        self.width = WIDE if few else NARROW
        self.queries = SHOWN_QUERIES[not few]
        by_scene: dict[str, list[Row]] = {}
        for row in own:
            by_scene.setdefault(row["scene"], []).append(row)
        opens = opening.choose_scenes((one.name, one.dataset, one.metrics) for one in scenes)
        pictured = {key[0] for key in (*chosen, *told)} | opens.keys()
        worst_first = sorted(scenes, key=lambda scene: scene.metrics.get("iou", 1.0))
        with_parts = {scene.name for scene in worst_first[:MOST]}
        for scene in scenes:
            rows = by_scene.get(scene.name, [])
            asked = {key_of(row): row for row in rows}
            images: Images = {}
            if scene.name in pictured | with_parts:
                images = scene.pictures()
            carded, keys = chosen & asked.keys(), [key for key in told if key in asked]
            if scene.name in opens:
                self.exhibits.append(self._exhibit(scene, rows, images, opens[scene.name]))
            truth = scene.truth() if carded or keys else {}
            for key in carded:
                self.cards[key] = self._card(images, truth, key)
            if keys:
                self._compare(images, truth, scene, keys, asked[keys[0]], others)
            part = self._part(scene, rows, images if scene.name in with_parts else {})
            self.parts.append(part | {"exhibited": scene.name in opens})

    def _exhibit(
        self, scene: Scene, rows: Sequence[Row], images: Images, why: str
    ) -> dict[str, Any]:
        method = rows[0]["method"] if rows else ""
        shown = opening.exhibit(scene.name, rows, images, scene.truth, lambda: scene.masks(method))

        def encoded(named: Images) -> dict[str, str]:
            return {name: data_uri(picture, SHOWN) for name, picture in named.items()}

        named = {
            name: None if picture is None else data_uri(picture, opening.LARGE)
            for name, picture in (("told", shown.told), ("truth", shown.truth))
        }
        cards = []
        for row in shown.rows:
            kinds = {
                kind: data_uri(images[f"{kind}/{row['frame']}/{row['query']}"], SHOWN)
                for kind in ("relevancy", "mask")
            }
            lost = self.lost_by.get(key_of(row), "")
            cards.append({"row": row, "sources": {"photo": None, **kinds}, "lost_by": lost})
        return {
            "scene": scene.name,
            "why": why,
            "frame": shown.frame,
            "photographs": encoded(shown.photographs),
            "walk": encoded(shown.walk),
            "view": encoded(shown.view),
            "cards": cards,
            "asked": sum(row["frame"] == shown.frame for row in rows),
            "scored": any(row["iou"] is not None for row in shown.rows),
            **named,
        }

    def _card(self, images: Images, truth: Mapping[str, Images], key: Key) -> dict[str, str]:
        _, frame, query = key
        photo = showcase.outlined(images[f"photo/{frame}"], truth[frame][query])
        found = {"photo": photo} | {
            kind: images[f"{kind}/{frame}/{query}"] for kind in ("relevancy", "mask")
        }
        return {kind: data_uri(picture, ANSWER) for kind, picture in found.items()}

    def _compare(
        self,
        images: Images,
        truth: Mapping[str, Images],
        scene: Scene,
        keys: Sequence[Key],
        row: Row,
        others: Mapping[str, Sequence[Row]],
    ) -> None:
        for method in (row["method"], *others):
            if not any(other["method"] == method for other in scene.rows):
                continue
            masks = scene.masks(method)
            for key in keys:
                _, frame, query = key
                photo, mask = images[f"photo/{frame}"], truth[frame][query]
                tiles = self.tiles.setdefault(
                    key, {"": data_uri(showcase.outlined(photo, mask), TILE)}
                )
                found = masks.get((row["protocol"], frame, query))
                if found is not None:
                    tiles[method] = data_uri(showcase.answered(photo, mask, found), TILE)

    def _part(self, scene: Scene, rows: Sequence[Row], images: Images) -> dict[str, Any]:
        """What the template needs of one scene, pictures encoded."""

        def frames(kind: str) -> list[str]:
            return [name.split("/", 1)[1] for name in images if name.startswith(f"{kind}/")]

        targets = frames("photo")[:SHOWN_TARGETS]
        drawn = [row for row in rows if f"mask/{row['frame']}/{row['query']}" in images]
        queries = self._choose(drawn)
        wanted = {f"{kind}/{frame}" for kind in ("photo", "render", "ids") for frame in targets}
        wanted |= {f"{kind}/{frame}" for kind in ("render", "ids") for frame in ALONG_THE_WAY}
        wanted |= {
            f"{kind}/{row['frame']}/{row['query']}"
            for kind in ("relevancy", "mask")
            for row in queries
        }
        always = "input", "labels", "depth", "true_depth", "depth_error"
        uris = {
            name: data_uri(images[name], self.width)
            for name in images
            if name in wanted or name.split("/", 1)[0] in always
        }
        return {
            "name": scene.name,
            "metrics": scene.metrics,
            "images": uris,
            "inputs": frames("input"),
            "targets": targets,
            "more_targets": len(frames("photo")) - len(targets),
            "path": [frame for frame in ALONG_THE_WAY if f"render/{frame}" in images],
            "queries": queries,
            "rows": rows,
        }

    def _choose(self, rows: Sequence[Row]) -> list[Row]:
        """The worst answered queries and the best, worst first; the first if none is scored."""
        scored = showcase.ranked(rows)
        if not scored:
            return list(rows[: self.queries])
        if len(scored) <= self.queries:
            return scored
        half = self.queries // 2
        return [*scored[:half], *scored[half - self.queries :]]


def _grouped(failures: Sequence[Mapping[str, str]]) -> list[tuple[str, str, str]]:
    """Scenes, stage and reason, those of one reason in one line."""
    scenes: dict[tuple[str, str], list[str]] = {}
    for failure in failures:
        scenes.setdefault((failure["stage"], failure["reason"]), []).append(failure["scene"])
    return [(_some(names), *why) for why, names in scenes.items()]


def _some(names: Sequence[str], count: int = 3) -> str:
    more = len(names) - count
    return "; ".join(names[:count]) + (f"; and {more} more" if more > 0 else "")


def _card(row: Row, lost_by: Mapping[Key, str]) -> dict[str, Any]:
    return {
        "key": key_of(row),
        "row": row,
        "lost_by": lost_by.get(key_of(row), ""),
        "file": f"predictions/{mask_place(row).as_posix()}",
    }


def _answers(key: Key, own: Sequence[Row], others: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """The IoU of every method that answered a query, ours first."""
    ious = {
        row["method"]: row["iou"]
        for rows in (own, *others.values())
        for row in rows
        if key_of(row) == key and row["iou"] is not None
    }
    return {"key": key, "ious": ious, "about": {method: about(method) for method in ious}}


def _main_tables(scores: Sequence[Row]) -> list[Table]:
    """A table a data set of scores of one protocol, those that all data sets have, best first."""
    if not scores:
        return []
    protocol = scores[0]["protocol"].partition("@")[0]
    had = [
        {score["metric"] for score in scores if score["dataset"] == dataset}
        for dataset in dict.fromkeys(score["dataset"] for score in scores)
    ]
    columns: list[Column] = [
        column
        for column in (*MAIN, *MORE)
        if column.protocol == protocol
        and column.metric in SCORE_TERMS
        and all(column.metric in metrics for metrics in had)
    ]
    if any(column.metric == "hit_mask" for column in columns):
        columns = [column for column in columns if column.metric != "hit_box"]
    tables = method_tables(scores, columns)
    return [
        replace(one, lines=tuple(sorted(one.lines, key=lambda line: line.cells[0].value)[::-1]))
        for one in tables
    ]


def _score_terms(tables: Sequence[Table], scores: Sequence[Row]) -> dict[str, str]:
    """What stands in the first table, by the name it has there."""
    if not tables:
        return {}
    terms = {column.title: SCORE_TERMS[column.metric] for column in tables[0].columns}
    if any(score["low"] is not None for score in scores):
        terms["small numbers"] = (
            f"where {100 * LEVEL:.0f} % of the means lie if scenes, or the places that they show, "
            "are drawn anew; methods whose ranges overlap much may be equally good"
        )
    if any(score["selection"] == "near-best" for score in scores):
        terms["near-best"] = NEAR_BEST_TERM
    return terms | COST_TERMS


def _key_numbers(
    scenes: Sequence[Scene], scores: Sequence[Row], ours: str
) -> dict[str, list[tuple[str, opening.KeyNumber]]]:
    """What stands at the top, by title: the number of each of the first data sets."""
    found: dict[str, list[tuple[str, opening.KeyNumber]]] = {}
    for dataset in list(dict.fromkeys(scene.dataset for scene in scenes))[: opening.SHOWN_SETS]:
        own = [score for score in scores if score["dataset"] == dataset]
        metrics = [scene.metrics for scene in scenes if scene.dataset == dataset]
        for one in opening.key_numbers(dataset, own, metrics, ours):
            found.setdefault(one.title, []).append((dataset, one))
    return found


def _photographs(manifest: Mapping[str, Any]) -> str:
    """How many photographs the scenes are made of, as text."""
    counts = {len(of["context"]) for of in manifest.get("data", {}).values() if "context" in of}
    if not counts:
        return "photographs"
    low, high = min(counts), max(counts)
    return f"{low} photographs" if low == high else f"{low} to {high} photographs"


def _unseen(manifest: Mapping[str, Any]) -> bool:
    """Whether no view that is asked is among those that the method was given."""
    entries = manifest.get("data", {}).values()
    return all(set(of.get("context", ())).isdisjoint(of.get("targets", ())) for of in entries)


def _counts(own: Sequence[Row]) -> dict[str, int]:
    scored = [row for row in own if row["iou"] is not None]
    low = [row for row in scored if row["iou"] < showcase.MISS]
    beside = [row for row in scored if not row["hit_mask"]]
    return {
        "scored": len(scored),
        "unscored": len(own) - len(scored),
        "unknown": sum(row["note"].startswith(NOT_UNDERSTOOD) for row in own),
        "low": len(low),
        "beside": len(beside),
        "missed": len({key_of(row) for row in (*low, *beside)}),
    }


Lost = list[tuple[str, int, dict[str, float | None]]]
"""By what lost queries: how many, and their mean IoU with each stage replaced."""


def _attribution_tables(attribution: Sequence[Row]) -> list[tuple[str, Lost]]:
    """What lost the queries of each data set, and of all of them in the last line."""
    tables = []
    for dataset in dict.fromkeys(row["dataset"] for row in attribution):
        own = [row for row in attribution if row["dataset"] == dataset]
        groups: dict[str, list[Row]] = {}
        for row in own:
            groups.setdefault(row["lost"] or "no miss", []).append(row)
        ordered = sorted(groups.items(), key=lambda item: (item[0] == "no miss", -len(item[1])))
        lines = [(name, len(rows), _mean_ious(rows)) for name, rows in ordered]
        tables.append((dataset, [*lines, ("all", len(own), _mean_ious(own))]))
    return tables


def _mean_ious(rows: Sequence[Row]) -> dict[str, float | None]:
    known = {name: [row[name] for row in rows if row[name] is not None] for name in STAND_INS}
    return {name: float(np.mean(ious)) if ious else None for name, ious in known.items()}


def _account_cells(account: Account) -> tuple[str, ...]:
    """The line of a field under :data:`ACCOUNT_COLUMNS`."""
    counts = account.gaussians_made, account.gaussians_kept
    changes = account.change_mean, account.change_rms, account.change_greatest
    told = (
        account.depths_tried, account.depths_possible, account.code_dimensions,
        account.replicas_computed, account.replicas_asked,
    )  # fmt: skip
    return (
        *(f"{count:,}" for count in counts),
        f"{counts[1] / max(counts[0], 1):.0%}",
        *(f"{change:.2f}" for change in changes),
        *("–" if number is None else f"{number:,}" for number in told),
        *(f"{size / 1e6:.1f}" for size in (account.bytes_gaussians, account.bytes_bank)),
    )


def _summaries(scenes: Sequence[Scene]) -> list[tuple[str, list[str], Summary]]:
    """The name of each data set, its scenes, and what is said of them."""
    found = []
    for dataset in dict.fromkeys(scene.dataset for scene in scenes):
        own = [scene for scene in scenes if scene.dataset == dataset]
        names = [scene.name for scene in own]
        found.append((dataset, names, summarize([scene.metrics for scene in own])))
    return found


def _published(manifest: Mapping[str, Any]) -> dict[str, Standing]:
    """The scenes that are published ones, or called like one and are not."""
    entries = manifest.get("data", {}).items()
    return {name: Standing(**of["published"]) for name, of in entries if of.get("published")}


def _estimated(manifest: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The scenes whose cameras were not given, and what is said of those."""
    entries = manifest.get("data", {}).items()
    found = []
    for name, of in entries:
        cameras, left_out = of.get("cameras", "given"), list(of.get("left_out", {}))
        aside = f"; without {', '.join(left_out)}, which cannot be placed" if left_out else ""
        if cameras != "given":
            found.append((name, cameras + aside))
    return found


def _plots(
    scores: Sequence[Row], by_method: Mapping[str, Sequence[Row]], ours: str
) -> dict[str, dict[str, str]]:
    """Plots by data set, each with its caption."""
    found: dict[str, dict[str, str]] = {}
    for dataset in dict.fromkeys(score["dataset"] for score in scores):
        own = [score for score in scores if score["dataset"] == dataset]
        ious = [s for s in own if s["metric"] == "iou" and s["protocol"].startswith("slgaussian@")]
        curves: dict[str, dict[float, float]] = {}
        for score in own:
            if score["protocol"].startswith("threshold-free") and score["threshold"] is not None:
                curves.setdefault(score["method"], {})[score["threshold"]] = score["value"]
        sure = {}
        for method, rows in by_method.items():
            mine = [
                row
                for row in rows
                if row["dataset"] == dataset and row["protocol"].startswith("slgaussian@")
            ]
            if (one := reliability(mine)).counts.any():
                sure[method] = one
        drawn = {}
        if len(ious) > 1:
            caption = f"IoU by {ious[0]['protocol']}, with its interval over scenes"
            drawn[caption] = plots.plot_scores(ious, ours)
        if curves:
            drawn["IoU with each threshold of the relevancy"] = plots.plot_curves(curves, ours)
        if sure:
            caption = "Calibration: how often the point is right, by how sure; larger: more queries"
            drawn[caption] = plots.plot_reliability(sure, ours)
        found[dataset] = drawn
    return found
