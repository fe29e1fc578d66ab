"""Object ids that agree across views: propose, propagate, merge, replicate, vote (section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import find_objects

from slgaussian.errors import InputError
from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.masks import MaskProposer, MaskTracker
from slgaussian.masks.consensus import settle
from slgaussian.masks.flatten import (
    CRUMB_SHARE,
    flatten,
    nearest_pixel,
    renumbered,
    without_crumbs,
)
from slgaussian.masks.vote import vote

SAME_IOU = 0.5
"""A detection that overlaps a propagated object by more than this IoU is that object."""
DOMINANT = 0.75
"""A detection of whose known pixels one object holds at least this share is (part of) it."""
KNOWN = 0.4
"""With less of it known, a detection that IoU does not match is a new object."""


def associate(
    seen: Sequence[SeenView],
    proposer: MaskProposer,
    tracker: MaskTracker,
    replicas: int = 5,
    back: MaskTracker | None = None,
) -> LabelMaps:
    """Label maps of a sequence of views with ids that mean the same object in every view.

    Views of which the tracker says that they show one thing need not follow each other: it
    remembers them all. What it cannot know when it comes to a view, the votes of all views settle
    in the end, if there are three or more and all have a depth: :mod:`slgaussian.masks.consensus`.

    The paper repeats every view five times, in block order (view 1 x 5, then view 2 x 5), tracks
    the sequence and votes per pixel. Here, as there, the first copy of a view is its detection: the
    labels propagated from all earlier views, merged with fresh proposals (:func:`match_detections`)
    and then remembered. The later copies are propagations from that memory.

    Copies are asked of the tracker one after the other until one repeats its predecessor. From
    there on, image, memory and last answer are the same again, so every further copy would be the
    same too; it counts and is not computed: :attr:`LabelMaps.computed` says how many were. Trackers
    that return remembered labels for a remembered image, like ``geometric``, thus cost one look-up
    a view and the vote is unanimous: copies do nothing for them. One that segments a
    remembered image anew, like ``sam2-video``, is asked twice, and its own answer has the majority
    over the detection from three copies on. One with a working memory is asked up to
    ``replicas - 1`` times and its noise is voted down.

    Parameters
    ----------
    seen : sequence of V SeenView
        In the order in which they are tracked; all of one size.
    proposer : MaskProposer
    tracker : MaskTracker
        Fresh, without memory.
    replicas : int
        Copies of every view, at least 1; 1 is the detection alone.
    back : MaskTracker, optional
        A second fresh tracker, for a reverse pass: see :func:`reconcile`.

    Returns
    -------
    LabelMaps
        Ids from 1 in order of appearance: those of the first view by falling area. A photograph
        that is added at the end leaves those of the others as they are, but for objects that its
        votes join or split. Two views have no gaps in their ids.
        Objects seen in one view only are kept (:attr:`LabelMaps.seen_once`). 0 is left only where
        nothing was proposed. Of a ``final`` tracker, its ids as they are. The same input gives the
        same ids.

    Raises
    ------
    InputError
        If there is no view, views differ in size, or ``replicas`` is below 1.
    """
    if not seen:
        raise InputError("associate: found no views, expected at least one")
    if replicas < 1:
        raise InputError(f"replicas: found {replicas}, expected at least 1")
    for here in seen:
        if here.image.shape != seen[0].image.shape:
            raise InputError(
                f"view {here.view.name!r}: image is {here.image.shape}, the first view's is "
                f"{seen[0].image.shape}; label maps have one size, so bring all views to it"
            )
    if tracker.final:
        given = [tracker.propagate(here) for here in seen]
        return LabelMaps(np.stack(given), np.ones((len(given), *given[0].shape), np.float32), 1)
    winners, margins, cuts = [], [], []
    known = computed = 0
    for index, here in enumerate(seen):
        carried = tracker.propagate(here) if index else np.zeros(here.image.shape[:2], np.int32)
        detected = _detect(here, proposer, carried)
        cuts.append(detected)
        first = without_crumbs(match_detections(carried, detected, known + 1))
        first = _without_gaps(first, known)
        known = max(known, int(first.max()))
        tracker.add(here, first)
        copies, times, asked = _copies(here, tracker, first, replicas)
        computed = max(computed, asked)
        labels, margin = vote(copies, times)
        winners.append(labels)
        margins.append(margin)
    labels = np.stack(winners)
    if back is not None:
        labels = reconcile(seen, labels, back)
    labels = renumbered(labels)
    if all(here.depth is not None for here in seen):
        labels = settle(seen, labels, np.stack(cuts))
    return LabelMaps(labels, np.stack(margins), computed)


def match_detections(carried: np.ndarray, detected: np.ndarray, next_id: int) -> np.ndarray:
    """Give every detected region the id of the propagated object it is, or a new one.

    A region takes an old id whole if their IoU is above 0.5, or if most of the region is known and
    nearly all of that is one object: views are cut up differently, and a piece of an object is
    still that object. A region that is mostly unknown is a new object. A region that is
    known as several objects is an under-segmentation of this view: each known pixel keeps its
    object and the others take the nearest one in the region. Pixels without a detection keep what
    was propagated. New ids count up from ``next_id`` in the order of the detected labels.

    Parameters
    ----------
    carried, detected : int32 [H, W]
        Propagated labels and detected regions, 0 where there is none.
    next_id : int
        First id that is not in use.
    """
    out = carried.copy()
    regions, objects = int(detected.max(initial=0)) + 1, int(carried.max(initial=0)) + 1
    table = np.bincount((detected.astype(np.int64) * objects + carried).ravel())
    table = np.pad(table, (0, regions * objects - len(table))).reshape(regions, objects)
    object_area = table.sum(0)
    windows = find_objects(detected)
    for region in range(1, regions):
        shared = table[region].copy()
        area = shared.sum()
        if area == 0:
            continue
        shared[0] = 0
        covered = shared.sum()
        best = int(shared.argmax())
        iou = shared[best] / (area + object_area[best] - shared[best])
        window = windows[region - 1]
        inside, new = detected[window] == region, out[window]
        if covered > 0 and (
            iou > SAME_IOU or (covered >= KNOWN * area and shared[best] >= DOMINANT * covered)
        ):
            new[inside] = best
        elif covered < KNOWN * area:
            new[inside] = next_id
            next_id += 1
        else:
            old = carried[window]
            new[inside] = old[nearest_pixel(inside & (old > 0))][inside]
    return out


def reconcile(seen: Sequence[SeenView], labels: np.ndarray, tracker: MaskTracker) -> np.ndarray:
    """Find objects that the way forth took for new, on the way back.

    The views are tracked from the last to the first. An object that is new in a later view and is
    carried onto one that no later view has, with an IoU above 0.5, is that object: it takes its id.
    The larger IoU goes first, then the lower ids.

    Parameters
    ----------
    seen
        As in :func:`associate`.
    labels : int32 [V, H, W]
    tracker : MaskTracker
        Fresh, without memory.
    """
    labels = labels.copy()
    tracker.add(seen[-1], labels[-1])
    for index in reversed(range(len(seen) - 1)):
        carried = tracker.propagate(seen[index])
        new = np.setdiff1d(labels[index + 1 :], labels[: index + 1])
        gone = np.setdiff1d(labels[: index + 1], labels[index + 1 :])
        renamed: dict[int, int] = {}
        for _, one, other in sorted(_overlaps(carried, labels[index], new, gone)):
            if one not in renamed and other not in renamed.values():
                renamed[one] = other
        for one, other in renamed.items():
            labels[labels == one] = other
        tracker.add(seen[index], labels[index])
    return labels


def _overlaps(
    a: np.ndarray, b: np.ndarray, ids_a: np.ndarray, ids_b: np.ndarray
) -> list[tuple[float, int, int]]:
    """(-IoU, id in a, id in b) of the given ids above 0 whose masks overlap by more than 0.5."""
    columns = int(b.max(initial=0)) + 1
    pairs, shared = np.unique(a.astype(np.int64) * columns + b, return_counts=True)
    area_a, area_b = np.bincount(a.ravel()), np.bincount(b.ravel())
    one, other = np.divmod(pairs, columns)
    iou = shared / (area_a[one] + area_b[other] - shared)
    keep = (iou > SAME_IOU) & np.isin(one, ids_a[ids_a > 0]) & np.isin(other, ids_b[ids_b > 0])
    return list(zip((-iou[keep]).tolist(), one[keep].tolist(), other[keep].tolist(), strict=True))


def _detect(seen: SeenView, proposer: MaskProposer, carried: np.ndarray) -> np.ndarray:
    """Proposals of a view as labels, asked for again where neither they nor the past reach."""
    detected = flatten(proposer.propose(seen))
    missed = (detected == 0) & (carried == 0)
    if missed.sum() >= CRUMB_SHARE * missed.size and detected.any():
        more = flatten(proposer.propose(seen, missed))
        detected = np.where(missed & (more > 0), more + detected.max(), detected)
    return detected


def _without_gaps(labels: np.ndarray, known: int) -> np.ndarray:
    """Number labels above ``known`` from there on without gaps, in their order."""
    new = np.unique(labels[labels > known])
    table = np.arange(int(labels.max(initial=0)) + 1, dtype=np.int32)
    table[new] = known + 1 + np.arange(len(new))
    return table[labels]


def _copies(
    seen: SeenView, tracker: MaskTracker, first: np.ndarray, replicas: int
) -> tuple[np.ndarray, list[int], int]:
    """The different copies of a view, int32 [R, H, W], how often each counts, and how many were
    computed; see :func:`associate`.
    """
    copies, computed = [first], 1
    while len(copies) < replicas:
        again = tracker.propagate(seen)
        computed += 1
        if np.array_equal(again, copies[-1]):
            break
        copies.append(again)
    times = [1] * (len(copies) - 1) + [replicas - len(copies) + 1]
    return np.stack(copies), times, computed
