"""Consistent object ids across views: propose, propagate, merge, replicate, vote (section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import find_objects

from slgaussian.errors import InputError
from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.masks import MaskProposer, MaskTracker
from slgaussian.masks.consensus import vote_on_objects
from slgaussian.masks.flatten import CRUMB_SHARE, flatten, nearest_pixel, remove_crumbs, renumber

SAME_IOU = 0.5
"""IoU with a propagated object above which a detection is that object."""
PART_SHARE = 0.75
"""Share of the known pixels of a detection in one object from which it is a part of that object."""
MIN_KNOWN_SHARE = 0.4
"""Share of known pixels below which a detection without a match by IoU is a new object."""


def associate(
    frames: Sequence[SeenView],
    proposer: MaskProposer,
    tracker: MaskTracker,
    replicas: int = 5,
    votes: str = "views",
) -> LabelMaps:
    """Compute label maps of a sequence of views with consistent object ids.

    As in the paper, every view is repeated, in block order, and its copies vote per pixel. The
    first copy is its detection: the labels propagated from all earlier views, merged with fresh
    proposals (:func:`match_detections`) and then remembered. The later copies are propagations from
    that memory. Those of a ``repeatable`` tracker are identical, so one is computed
    (:attr:`LabelMaps.computed`) and has the weight of all of them.

    Errors that a tracker cannot avoid, because it has not yet seen later views, are corrected
    afterwards by a vote of all views, if there are three or more and all have a depth
    (:mod:`slgaussian.masks.consensus`).

    Args:
        frames: sequence of V SeenView. In the order in which they are tracked; all of one size.
        tracker: Fresh, without memory.
        replicas: Copies of every view, at least 1; 1 is the detection alone.
        votes: "views" or "copies". ``views`` as described above; ``copies`` as in the paper: all
            copies are computed, and their vote is final.

    Returns:
        LabelMaps: Ids from 1 in order of appearance, in the first view by falling area; 0 without a
            proposal. Objects in one view only are kept. The ids of a ``final`` tracker are returned
            unchanged.

    Raises:
        InputError: If there is no view, views differ in size, or ``replicas`` is below 1.
    """
    if not frames:
        raise InputError("associate: found no views, expected at least one")
    if replicas < 1:
        raise InputError(f"replicas: found {replicas}, expected at least 1")
    for frame in frames:
        if frame.image.shape != frames[0].image.shape:
            raise InputError(
                f"view {frame.view.name!r}: image is {frame.image.shape}, the first view's is "
                f"{frames[0].image.shape}; label maps have one size, so bring all views to it"
            )
    if tracker.final:
        tracked = np.stack([tracker.propagate(frame) for frame in frames])
        return LabelMaps(tracked, np.ones(tracked.shape, np.float32), 1)
    winners, margins, detections = [], [], []
    last_id, computed, all_copies = 0, 1, votes == "copies"
    for index, frame in enumerate(frames):
        unlabelled = np.zeros(frame.image.shape[:2], np.int32)
        propagated = tracker.propagate(frame) if index else unlabelled
        detected = _detect(frame, proposer, propagated)
        detections.append(detected)
        first = remove_crumbs(match_detections(propagated, detected, last_id + 1))
        last_id = max(last_id, int(first.max()))
        tracker.add(frame, first)
        copies, times = _copies(frame, tracker, first, replicas, all_copies)
        computed = len(copies)
        labels, margin = vote(copies, times)
        winners.append(labels)
        margins.append(margin)
    labels = renumber(np.stack(winners))
    if not all_copies and all(frame.depth is not None for frame in frames):
        labels = vote_on_objects(frames, labels, np.stack(detections))
    return LabelMaps(labels, np.stack(margins), computed)


def match_detections(propagated: np.ndarray, detected: np.ndarray, next_id: int) -> np.ndarray:
    """Assign every detected region the id of a propagated object, or a new one.

    A region takes the id of an object if their IoU is above :data:`SAME_IOU`, or if it is known
    (:data:`MIN_KNOWN_SHARE`) and most known pixels are of that object (:data:`PART_SHARE`). A
    region with few known pixels is a new object. In a region of several objects known pixels keep
    their object, and others take the nearest one. Pixels without detection keep their propagated
    label.

    Args:
        propagated, detected: int32 [H, W]. Labels and regions, 0 where there is none.
        next_id: First id that is not in use; new ids count up in the order of the regions.
    """
    out = propagated.copy()
    regions, objects = int(detected.max(initial=0)) + 1, int(propagated.max(initial=0)) + 1
    table = np.bincount((detected.astype(np.int64) * objects + propagated).ravel())
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
            iou > SAME_IOU
            or (covered >= MIN_KNOWN_SHARE * area and shared[best] >= PART_SHARE * covered)
        ):
            new[inside] = best
        elif covered < MIN_KNOWN_SHARE * area:
            new[inside] = next_id
            next_id += 1
        else:
            old = propagated[window]
            new[inside] = old[nearest_pixel(inside & (old > 0))][inside]
    return out


def _detect(frame: SeenView, proposer: MaskProposer, propagated: np.ndarray) -> np.ndarray:
    """Return the proposals of a view as labels, with a second pass for uncovered pixels."""
    detected = flatten(proposer.propose(frame))
    missed = (detected == 0) & (propagated == 0)
    if missed.sum() >= CRUMB_SHARE * missed.size and detected.any():
        extra = flatten(proposer.propose(frame, missed))
        detected = np.where(missed & (extra > 0), extra + detected.max(), detected)
    return detected


def _copies(
    frame: SeenView, tracker: MaskTracker, first: np.ndarray, replicas: int, all_copies: bool
) -> tuple[np.ndarray, list[int]]:
    """Return the computed copies of a view, int32 [R, H, W], and the weight of each in the vote."""
    shortcut = getattr(tracker, "repeatable", False) and not all_copies
    count = min(1, replicas - 1) if shortcut else replicas - 1
    copies = [first, *(tracker.propagate(frame) for _ in range(count))]
    return np.stack(copies), [1] * count + [replicas - count]


def vote(stack: np.ndarray, times: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Compute the per-pixel majority of label maps of R replicas (paper, equation 4).

    Label 0 (no object) counts like any other. Ties go to the first label in replica order.

    Args:
        stack: int32 [R, H, W]. One label map per replica, R at least 1.
        times: sequence of int, optional. Number of equal replicas that each map stands for.

    Returns:
        labels: int32 [H, W]
        margin: float32 [H, W]. (votes for the winner - votes for the runner-up) / R, 0 to 1.
    """
    weights = np.ones(len(stack), np.int32) if times is None else np.array(times, np.int32)
    counts = np.stack([np.tensordot(weights, stack == replica, 1) for replica in stack])
    first = counts.argmax(0)[None]  # argmax returns the first maximum, as ties require
    labels = np.take_along_axis(stack, first, 0)[0]
    winner = counts.max(0)
    runner_up = np.where(stack == labels, 0, counts).max(0)
    return labels, ((winner - runner_up) / weights.sum()).astype(np.float32)
