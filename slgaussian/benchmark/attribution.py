"""Which stage lost a miss: truth takes the place of one stage after the other, from the end.

A replacement keeps all those made before it. The first one that mends the miss names the stage that
lost it: with everything after that stage true it was still a miss, with the stage itself true it is
none. In plain words, with its limits, it is in `docs/reference/failures.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from slgaussian.benchmark import metrics, oracles
from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.evaluate import EvaluationSettings
from slgaussian.benchmark.scores import GOOD
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.language.locate import central_point
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import QueryResult, Rules, ask
from slgaussian.scene import Sample, View
from slgaussian.storage.specs import load_spec

STAGES = {
    "threshold": "threshold",
    "language": "language",
    "pieces": "mask: in pieces",
    "parted": "association",
    "mask": "mask: no border",
    "geometry": "geometry",
}
"""The replacements in the order in which they are made, each with the stage it puts right."""

STAND_INS = {
    "iou": ("as it is", ""),
    "threshold_iou": ("threshold", "each query cut where it is best for it"),
    "language_iou": ("language", "whole things named, one for each part of the truth"),
    "pieces_iou": ("pieces", "as many objects named as help"),
    "parted_iou": ("parted", "each view's own pieces, as before association"),
    "mask_iou": ("mask", "the true masks of the two photographs"),
    "geometry_iou": ("geometry", "their true depth"),
}
"""Columns of the spec ``attribution``: what is true from there on, in a word and in a line."""

UNDECIDED = "mask or geometry"
"""What lost a miss that true masks mend, where they were found by predicted depth: that is right by
its own measure, wherever it lies."""

MOSTLY = 0.5
"""Fraction of the truth in the context views that must not rest on predicted depth, to decide."""

BEYOND = "nothing mends it"
"""What lost a miss that stays one: the photographs do not show it, or the truth is rough."""


def attribute_errors(
    field: SemanticField,
    gaussians: Gaussians,
    sample: Sample,
    pieces: np.ndarray,
    truth: Truth,
    settings: EvaluationSettings | None = None,
) -> list[dict[str, Any]]:
    """Ask a field what the truth knows, and name the stage that lost each miss.

    Parameters
    ----------
    field : SemanticField
        A field of ``sample``.
    gaussians : Gaussians
        Those that were predicted for it, before the field merged any.
    sample : Sample
        True depths and instances are used where its context views have them.
    pieces : int32 [V, H, W]
        What was proposed in each context view, before association; 0 none. Numbers of different
        views have nothing to do with each other.
    truth : Truth
        Queries with an empty mask are left out.
    settings : EvaluationSettings, optional
        How rows are marked, and by which rules texts become answers: masks are those of whole
        objects, whatever the protocol.

    Returns
    -------
    list of dict
        A row a frame and query, with the columns of the data spec ``attribution``.
    """
    settings = settings or EvaluationSettings()
    rules = replace(settings.rules, protocol="slgaussian")
    common = {"dataset": settings.dataset, "scene": sample.scene, "method": settings.method}
    scene = _Scene(field, gaussians, sample, pieces)
    columns = load_spec("attribution").columns
    rows = []
    for target in sample.targets:
        masks = {q: mask for q, mask in truth.masks.get(target.name, {}).items() if mask.any()}
        if not masks:
            continue
        frame = _Frame(scene, target, masks, rules)
        for query in masks:
            row = common | {"frame": target.name, "query": query} | frame.row(query)
            rows.append({name: row[name] for name in columns})
    return rows


def verdict(row: Mapping[str, Any]) -> str | None:
    """Name the stage that lost the query of a row of spec ``attribution``; None without a miss."""
    if _is_good(row["iou"], row["hit"]):
        return None
    for name, stage in STAGES.items():
        if row[f"{name}_iou"] is not None and _is_good(row[f"{name}_iou"], row[f"{name}_hit"]):
            return UNDECIDED if name == "mask" and row["known"] < MOSTLY else stage
    return BEYOND


def _is_good(iou: float, hit: bool) -> bool:
    return iou >= GOOD and hit


@dataclass(frozen=True, eq=False)
class _Scene:
    """What all frames of a scene have in common."""

    field: SemanticField
    gaussians: Gaussians
    sample: Sample
    pieces: np.ndarray

    @cached_property
    def depths(self) -> np.ndarray:
        """Predicted depth of the context views."""
        cameras = [view.camera for view in self.sample.context]
        return source_depths(self.gaussians, cameras)

    @cached_property
    def views(self) -> list[Gaussians]:
        """The Gaussians of each context view."""
        return oracles.each_view(self.gaussians, len(self.pieces), self.pieces[0].size)

    @cached_property
    def moved(self) -> Gaussians | None:
        """The Gaussians where they belong; None if no true depth is known."""
        if not oracles.true_depths(self.sample).any():
            return None
        return oracles.moved(self.gaussians, self.sample, self.depths)


class _Frame:
    """One target view with everything that takes the place of a stage there."""

    def __init__(
        self, scene: _Scene, target: View, masks: Mapping[str, np.ndarray], rules: Rules
    ) -> None:
        field, gaussians, camera = scene.field, scene.gaussians, target.camera
        self.masks, self.rules, self.field = masks, rules, field
        self.places = {query: column for column, query in enumerate(masks)}
        self.seen = ObjectMap(field.render(camera).ids, field.bank.ids)
        apart = oracles.own_pieces(gaussians, scene.views, scene.pieces, camera)
        self.parted = [ObjectMap(own, np.unique(own[own > 0])) for own in apart]
        self.true = oracles.context_truth(scene.sample, target, masks, scene.depths)
        labels = self.true.labels.ravel()[gaussians.source.numpy()]
        self.drawn = {"mask": oracles.elect(gaussians, labels, camera)}
        if scene.moved is not None:
            self.drawn["geometry"] = oracles.elect(scene.moved, labels, camera)

    def row(self, query: str) -> dict[str, Any]:
        """Return the columns of a query but those that name it."""
        truth, hit = self.masks[query], self._ask(query)
        found, point = (np.zeros_like(truth), None) if hit is None else (hit.mask, hit.point)
        row: dict[str, Any] = {
            "iou": metrics.iou(found, truth),
            "hit": metrics.point_in_mask(point, truth),
        }
        pieces = oracles.best_pieces(self.seen, truth)
        wholes = oracles.best_wholes(self.seen, self.field.bank, truth)
        member = self.true.members[:, self.places[query]]
        masks = {
            "language": self.seen.spread(wholes),
            "pieces": self.seen.spread(pieces),
            "parted": self._parted(truth),
            **{name: member[labels] for name, labels in self.drawn.items()},
        }
        judged = {
            "threshold": self._cut(hit, truth),
            **{name: (metrics.iou(m, truth), _middle_is_in(m, truth)) for name, m in masks.items()},
        }
        for name in STAGES:
            row[f"{name}_iou"], row[f"{name}_hit"] = judged.get(name, (None, None))
        row |= {"parts": oracles.parts(truth), "objects": int(pieces.sum())}
        row["known"] = float(self.true.known[self.places[query]])
        return row | {"lost": verdict(row)}

    def _ask(self, query: str) -> QueryResult | None:
        """Return None if the query is not understood."""
        try:
            return ask([query], self.seen, self.field.reader, self.rules)[0]
        except InputError:
            return None

    def _cut(self, hit: QueryResult | None, truth: np.ndarray) -> tuple[float, bool]:
        """IoU with the best threshold, and whether a point is right: as found, or the best one's.

        No threshold gives another thing the best score.
        """
        if hit is None or not hit.score:
            return 0.0, False
        inside, total = self.seen.areas_within(truth), int(np.count_nonzero(truth))
        chosen = oracles.best_prefix(hit.scores, inside, self.seen.areas, total)
        best = int(np.where(self.seen.areas > 0, hit.scores, -1).argmax())
        points = hit.point, self.seen.point(best)
        right = any(metrics.point_in_mask(point, truth) for point in points)
        return metrics.iou(self.seen.spread(chosen), truth), right

    def _parted(self, truth: np.ndarray) -> np.ndarray:
        """The best mask of the pieces of any one view, or of all together."""
        masks = [seen.spread(oracles.best_pieces(seen, truth)) for seen in self.parted]
        return max(masks, key=lambda mask: metrics.iou(mask, truth))


def _middle_is_in(mask: np.ndarray, truth: np.ndarray) -> bool:
    return bool(mask.any()) and metrics.point_in_mask(central_point(mask), truth)
