"""From judgements of single lessons to whether one lifting is better than another."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.statistics import LEAST, LEVEL, Comparison, compare


@dataclass(frozen=True)
class Verdict:
    """Whether a gain is beyond noise, and a sentence that says so with its numbers."""

    better: bool
    why: str


def clip_scores(judgements: pa.Table, labels: str | None = None) -> dict[str, list[float]]:
    """Mean IoU of every lifting on every clip, the clips in one order.

    Lessons of one clip show one scene and are no independent samples, so a clip counts once.

    Parameters
    ----------
    judgements : table of spec ``judgements``
    labels : str, optional
        Those of its kinds of labels that count, by default all alike.

    Returns
    -------
    {lifting: list of float}
        In the order of the table. Clips without any object are left out.
    """
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in judgements.to_pylist():
        if row["iou"] is not None and labels in (None, row["labels"]):
            found[row["lifting"]][row["clip"]].append(row["iou"])
    return {
        lifting: [float(np.mean(own[clip])) for clip in sorted(own)]
        for lifting, own in found.items()
    }


def gain(judgements: pa.Table, other: str, labels: str | None = None) -> Comparison:
    """By how much the lifting ``branch`` is better than ``other``; InputError without a clip."""
    scores = clip_scores(judgements, labels)
    return compare(scores.get("branch", []), scores.get(other, []))


def verdict(judgements: pa.Table, other: str, called: str) -> Verdict:
    """Whether the lifting ``branch`` is better than ``other``, in a sentence ``called`` so.

    It is if the whole interval of the paired bootstrap is above 0, of :data:`LEAST` clips or more;
    labels as found and corrupted ones count alike.
    """
    found = gain(judgements, other)
    numbers = (
        f"{found.difference:+.4f} IoU ({found.low:+.4f} to {found.high:+.4f} in "
        f"{100 * LEVEL:.0f} % of the resamplings) on {found.samples} held-out clips"
    )
    if found.samples < LEAST:
        return Verdict(False, f"too few clips to tell it from {called}: {numbers}, {LEAST} needed")
    if found.low > 0:
        return Verdict(True, f"better than {called}: {numbers}")
    return Verdict(False, f"no gain over {called} beyond noise: {numbers}")
