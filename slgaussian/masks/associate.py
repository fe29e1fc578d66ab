"""Object ids that agree across views: propose, propagate, merge, replicate, vote (section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import find_objects

from slgaussian.components.method import VOTES
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
    votes: str = VOTES[0],
) -> LabelMaps:
    """Label maps of a sequence of views with ids that mean the same object in every view.

    Views of which the tracker says that they show one thing need not follow each other: it
    remembers them all.

    The paper repeats every view five times, in block order (view 1 x 5, then view 2 x 5), tracks
    the sequence and votes per pixel. Here, as there, the first copy of a view is its detection: the
    labels propagated from all earlier views, merged with fresh proposals (:func:`match_detections`)
    and then remembered. The later copies are propagations from that memory.

    Of a ``repeatable`` tracker, as ``geometric`` and ``sam2-video`` are, every later copy is the
    same: one is made, and counts for all. :attr:`LabelMaps.computed` says how many were made.
    Where the tracker returns remembered labels for a remembered image, as ``geometric`` does, the
    vote is unanimous; where it segments the image anew, its answer has the majority over the
    detection from three copies on; where it is not repeatable, its noise is voted down.

    What no tracker can know when it comes to a view, all views settle in the end, if there are
    three or more and all have a depth: :mod:`slgaussian.masks.consensus`.

    Parameters
    ----------
    seen : sequence of V SeenView
        In the order in which they are tracked; all of one size.
    proposer : MaskProposer
    tracker : MaskTracker
        Fresh, without memory.
    replicas : int
        Copies of every view, at least 1; 1 is the detection alone.
    votes : "views" or "copies"
        As above, or as the paper prints it: all copies are made, and their vote is the last word.

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
    known, computed, all_made = 0, 1, votes == "copies"
    for index, here in enumerate(seen):
        carried = tracker.propagate(here) if index else np.zeros(here.image.shape[:2], np.int32)
        detected = _detect(here, proposer, carried)
        cuts.append(detected)
        first = without_crumbs(match_detections(carried, detected, known + 1))
        first = _without_gaps(first, known)
        known = max(known, int(first.max()))
        tracker.add(here, first)
        copies, times = _copies(here, tracker, first, replicas, all_made)
        computed = len(copies)
        labels, margin = vote(copies, times)
        winners.append(labels)
        margins.append(margin)
    labels = renumbered(np.stack(winners))
    if not all_made and all(here.depth is not None for here in seen):
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
    seen: SeenView, tracker: MaskTracker, first: np.ndarray, replicas: int, all_made: bool
) -> tuple[np.ndarray, list[int]]:
    """The copies of a view that are made, int32 [R, H, W], and how often each counts."""
    same = getattr(tracker, "repeatable", False) and not all_made
    made = min(1, replicas - 1) if same else replicas - 1
    copies = [first, *(tracker.propagate(seen) for _ in range(made))]
    return np.stack(copies), [1] * made + [replicas - made]
