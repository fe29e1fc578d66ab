"""Scoring protocols, identified by name and version (`docs/reference/protocols.md`).

Numbers of different protocols are not comparable, even for metrics of the same name: LangSplat has
51.4 mIoU by its own protocol and 9.7 by that of OpenGaussian. So a protocol has a version, which is
raised when any of its results changes, and every row of scores contains ``name@version``.

A method answers a frame once, and each protocol scores these answers. For external masks without
relevancy it computes the metrics that masks allow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from slgaussian.benchmark import metrics
from slgaussian.errors import InputError, did_you_mean
from slgaussian.language import langsplat
from slgaussian.language.rules import Rules


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of a method to one text in one view.

    Attributes:
        relevancy: float [H, W]. In [0, 1]; 0 where unknown. Empty for an external mask.
        mask: bool [H, W]. Pixels that the method selects by its rules.
        point: (x, y) or None. Predicted location.
    """

    relevancy: np.ndarray
    mask: np.ndarray
    point: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Frame:
    """The answers of a method in one view, and the ground truth.

    Attributes:
        answers, masks, boxes: For each query: an :class:`Answer`, the true mask bool [H, W], and
            the true boxes float [n, 4] (x0, y0, x1, y1).
        labels: int32 [H, W] or None. ``k + 1`` where query ``k`` wins over all others, 0 where none
            does, -1 where the photograph is transparent; None if unknown.
        external: Whether masks are external: then there are no relevancies, and only some points.
    """

    answers: Sequence[Answer]
    masks: Sequence[np.ndarray]
    boxes: Sequence[np.ndarray]
    labels: np.ndarray | None
    external: bool = False

    def within(self, opaque: np.ndarray | None) -> Frame:
        """Return the frame without answers where ``opaque`` bool [H, W] is false, as is the truth.

        ``labels`` are -1 there. Points stay. None means that all is opaque.
        """
        if opaque is None:
            return self
        answers = [
            replace(
                answer,
                relevancy=answer.relevancy if self.external else answer.relevancy * opaque,
                mask=answer.mask & opaque,
            )
            for answer in self.answers
        ]
        labels = None if self.labels is None else np.where(opaque, self.labels, -1)
        return replace(self, answers=answers, labels=labels)

    @cached_property
    def class_ious(self) -> Sequence[float | None]:
        """See :func:`slgaussian.benchmark.metrics.class_ious`; None without labels."""
        if self.labels is None:
            return [None] * len(self.masks)
        return metrics.class_ious(self.labels, self.masks)

    @cached_property
    def accuracy(self) -> float | None:
        """See :func:`slgaussian.benchmark.metrics.exact_accuracy`."""
        return None if self.labels is None else metrics.exact_accuracy(self.labels, self.masks)


@dataclass(frozen=True, eq=False)
class Scored:
    """Scores of one query of a frame, by the columns of the data spec ``samples``.

    ``point`` (x, y) and ``mask`` bool [H, W] are the scored ones, None if a protocol has none.
    """

    scores: Mapping[str, Any]
    mask: np.ndarray | None = None
    point: tuple[float, float] | None = None


@dataclass(frozen=True)
class MaskSettings:
    """Settings of the mask selection, by the columns of the data spec ``samples``.

    Selections ``near-best`` and ``threshold`` are those of
    :class:`slgaussian.language.rules.Rules`; ``stretched`` is LangSplat's, ``arg-max`` the best of
    several texts, ``none`` no mask; ``given`` masks are external. ``filter`` is the side of
    LangSplat's mean filter, pixels.
    """

    selection: str
    threshold: float | None = None
    share: float | None = None
    filter: int | None = None


@dataclass(frozen=True)
class ScoringProtocol:
    """A scoring protocol.

    Attributes:
        version: Raised whenever a result may change.
        mask_settings: Settings for the rules of the query and the image width in pixels.
        score_query: Scores of query k of a frame.
        scores_masks: Whether it can score masks without relevancies.
    """

    name: str
    version: int
    mask_settings: Callable[[Rules, int], MaskSettings]
    score_query: Callable[[Frame, int, MaskSettings], Scored]
    scores_masks: bool = True

    @cached_property
    def label(self) -> str:
        """The name in rows and tables: ``name@version``."""
        return f"{self.name}@{self.version}"

    def score(self, frame: Frame, settings: MaskSettings) -> list[Scored]:
        """Score each query in order; a query with an empty true mask has no scores."""
        scored = [self.score_query(frame, k, settings) for k in range(len(frame.masks))]
        return [
            score if truth.any() else replace(score, scores={})
            for score, truth in zip(scored, frame.masks, strict=True)
        ]


def _slgaussian(frame: Frame, k: int, settings: MaskSettings) -> Scored:
    answer, truth = frame.answers[k], frame.masks[k]
    scores = metrics.overlap(answer.mask, truth) | {"class_iou": frame.class_ious[k]}
    if answer.point is not None or not frame.external:
        scores["hit_mask"] = metrics.point_in_mask(answer.point, truth)
        scores["hit_box"] = metrics.point_in_boxes(answer.point, frame.boxes[k])
    return Scored(scores, answer.mask, answer.point)


def _langsplat(frame: Frame, k: int, settings: MaskSettings) -> Scored:
    answer, truth, boxes = frame.answers[k], frame.masks[k], frame.boxes[k]
    mask, point, relevancy = answer.mask, answer.point, answer.relevancy
    scores: dict[str, Any] = {}
    if not frame.external:
        mask, point, peak = np.zeros_like(truth), None, np.zeros_like(truth)
        is_known = relevancy > 0
        if is_known.any():
            # Holes must not change the range to which the threshold is relative.
            image = np.where(is_known, relevancy, relevancy.min(where=is_known, initial=np.inf))
            side = settings.filter or langsplat.FILTER_SIDE
            mask = langsplat.find_mask(image, side)
            point, peak = langsplat.find_point(image, side)
        scores["hit_peak"] = metrics.any_in_boxes(peak, boxes)
    if point is not None or not frame.external:
        scores["hit_box"] = metrics.point_in_boxes(point, boxes)
    return Scored(metrics.overlap(mask, truth) | scores, mask, point)


def _highest_pixel(frame: Frame, k: int, settings: MaskSettings) -> Scored:
    """Localise by the first of the highest pixels in reading order; those of an object are tied."""
    relevancy = frame.answers[k].relevancy
    peak = (relevancy == relevancy.max()) & (relevancy > 0)
    row, column = np.unravel_index(int(peak.argmax()), peak.shape)
    point = (float(column), float(row)) if peak.any() else None
    scores = {
        "hit_box": metrics.point_in_boxes(point, frame.boxes[k]),
        "hit_mask": metrics.point_in_mask(point, frame.masks[k]),
        "hit_peak": metrics.any_in_boxes(peak, frame.boxes[k]),
    }
    return Scored(scores, None, point)


def _three_d_ovs(frame: Frame, k: int, settings: MaskSettings) -> Scored:
    assert frame.labels is not None  # texts always compete in this protocol
    region = frame.labels == k + 1
    scores = {
        "boundary_iou": metrics.boundary_iou(region, frame.masks[k]),
        "class_iou": frame.class_ious[k],
        "accuracy": frame.accuracy,
    }
    return Scored(scores, region, frame.answers[k].point if frame.external else None)


def _by_rules(rules: Rules, width: int) -> MaskSettings:
    share = rules.share if rules.selection == "near-best" else None
    return MaskSettings(rules.selection, rules.threshold, share)


def _langsplat_settings(rules: Rules, width: int) -> MaskSettings:
    return MaskSettings("stretched", langsplat.MASK_THRESHOLD, filter=langsplat.FILTER_SIDE)


def _rescaled_settings(rules: Rules, width: int) -> MaskSettings:
    return replace(_langsplat_settings(rules, width), filter=langsplat.rescaled_filter(width))


PROTOCOLS: Mapping[str, ScoringProtocol] = {
    protocol.name: protocol
    for protocol in (
        ScoringProtocol("slgaussian", 2, _by_rules, _slgaussian),
        ScoringProtocol("langsplat", 2, _langsplat_settings, _langsplat),
        ScoringProtocol("langsplat-rescaled", 2, _rescaled_settings, _langsplat),
        ScoringProtocol("3d-ovs", 2, lambda rules, width: MaskSettings("arg-max"), _three_d_ovs),
        ScoringProtocol(
            "highest-pixel", 1, lambda rules, width: MaskSettings("none"), _highest_pixel, False
        ),
    )
}
"""Protocols by name."""


def load_protocol(name: str) -> ScoringProtocol:
    """Return the protocol of a name; InputError, which lists the names, if unknown."""
    if name not in PROTOCOLS:
        raise InputError(
            f"protocol: found {name!r}, expected one of {', '.join(PROTOCOLS)}"
            f"{did_you_mean(name, PROTOCOLS)}"
        )
    return PROTOCOLS[name]
