"""Verdicts on liftings by judgements of single lessons: never beyond what an interval bears out."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.statistics import LEAST, LEVEL, Comparison, compare
from slgaussian.errors import InputError


@dataclass(frozen=True)
class Verdict:
    """Judgement whether a gain is beyond noise, and a sentence that says so with its numbers."""

    better: bool
    why: str


def clip_scores(judgements: pa.Table, labels: str | None = None) -> dict[str, list[float]]:
    """Return the mean IoU of every lifting on every clip, the clips in one order.

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


def gain(
    judgements: pa.Table, other: str, labels: str | None = None, of: str = "branch"
) -> Comparison:
    """Compare the lifting ``of`` with ``other``; InputError without a clip."""
    scores = clip_scores(judgements, labels)
    return compare(scores.get(of, []), scores.get(other, []))


def verdict(judgements: pa.Table, other: str, called: str) -> Verdict:
    """Judge whether the lifting ``branch`` is better than ``other``, in a sentence ``called`` so.

    It is if the whole interval of the paired bootstrap is above 0, of :data:`LEAST` clips or more;
    labels as found and corrupted ones count alike.
    """
    return _verdict(gain(judgements, other), called)


def gate(judgements: pa.Table, rivals: Mapping[str, str]) -> Verdict:
    """Judge whether ``branch`` is better than the best of several liftings, beyond noise.

    It must be better than each of them as :func:`verdict` has it. To claim that of all at some
    level, each is asked at that same level (an intersection-union test, Berger 1982). The sentence
    is about the one that it comes nearest to losing against.

    Parameters
    ----------
    judgements : table of spec ``judgements``
    rivals : {lifting: what it is called}
        Those that were not judged are passed over; InputError if none was.
    """
    judged = set(judgements["lifting"].to_pylist())
    gains = {called: gain(judgements, name) for name, called in rivals.items() if name in judged}
    if not gains:
        raise InputError(f"judgements: found {sorted(judged)}, expected one of {list(rivals)}")
    hardest = min(gains, key=lambda called: (gains[called].low, gains[called].difference))
    found = _verdict(gains[hardest], hardest)
    if found.better and len(gains) > 1:
        *others, last = [called for called in gains if called != hardest]
        also = f"{', '.join(others)} and {last}" if others else last
        return Verdict(True, f"{found.why}; and than {also}")
    return found


def regression(judgements: pa.Table, rivals: Mapping[str, str], called: str) -> str:
    """Return a sentence if what is in use is worse than any of ``rivals`` beyond noise, else "".

    That is, the lifting ``before``, ``called`` so: clips that arrived since may show what those it
    was put to use by did not.
    """
    judged = set(judgements["lifting"].to_pylist())
    if "before" not in judged:
        return ""
    gains = {
        rival: gain(judgements, name, of="before")
        for name, rival in rivals.items()
        if name in judged
    }
    worse = [rival for rival, found in gains.items() if found.samples >= LEAST and found.high < 0]
    if not worse:
        return ""
    worst = min(worse, key=lambda rival: gains[rival].difference)
    return f"{called}, in use, is worse than {worst}: {_numbers(gains[worst])}"


def _numbers(found: Comparison) -> str:
    return (
        f"{found.difference:+.4f} IoU ({found.low:+.4f} to {found.high:+.4f} in "
        f"{100 * LEVEL:.0f} % of the resamplings) on {found.samples} held-out clips"
    )


def _verdict(found: Comparison, called: str) -> Verdict:
    numbers = _numbers(found)
    if found.samples < LEAST:
        return Verdict(False, f"too few clips to tell it from {called}: {numbers}, {LEAST} needed")
    if found.low > 0:
        return Verdict(True, f"better than {called}: {numbers}")
    if found.high < 0:
        return Verdict(False, f"worse than {called}: {numbers}")
    return Verdict(False, f"no gain over {called} beyond noise: {numbers}")
