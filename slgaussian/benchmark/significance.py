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
    by_clip: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in judgements.to_pylist():
        if row["iou"] is not None and labels in (None, row["labels"]):
            by_clip[row["lifting"]][row["clip"]].append(row["iou"])
    return {
        lifting: [float(np.mean(scores[clip])) for clip in sorted(scores)]
        for lifting, scores in by_clip.items()
    }


def gain(
    judgements: pa.Table, rival: str, labels: str | None = None, of: str = "branch"
) -> Comparison:
    """Compare the lifting ``of`` with ``rival``; InputError without a clip."""
    scores = clip_scores(judgements, labels)
    return compare(scores.get(of, []), scores.get(rival, []))


def gate(judgements: pa.Table, rivals: Mapping[str, str]) -> Verdict:
    """Judge whether ``branch`` is better than the best of several liftings, beyond noise.

    The whole interval of the paired bootstrap against each of them must be above 0, of
    :data:`LEAST` clips or more; labels as found and corrupted ones count alike. To claim that of
    all at some level, each is asked at that same level (an intersection-union test, Berger 1982).
    The sentence is about the one that it comes nearest to losing against.

    Parameters
    ----------
    judgements : table of spec ``judgements``
    rivals : {lifting: its name in the sentence}
        Those that were not judged are passed over; InputError if none was.
    """
    gains = _gains(judgements, rivals, "branch")
    if not gains:
        judged = sorted(set(judgements["lifting"].to_pylist()))
        raise InputError(f"judgements: found {judged}, expected one of {list(rivals)}")
    hardest = min(gains, key=lambda name: (gains[name].low, gains[name].difference))
    comparison = gains[hardest]
    numbers = _describe(comparison)
    if comparison.samples < LEAST:
        needed = f"{numbers}, {LEAST} needed"
        return Verdict(False, f"too few clips to tell it from {hardest}: {needed}")
    if comparison.high < 0:
        return Verdict(False, f"worse than {hardest}: {numbers}")
    if comparison.low <= 0:
        return Verdict(False, f"no gain over {hardest} beyond noise: {numbers}")
    rest = " and ".join(name for name in gains if name != hardest)
    rest = f"; and than {rest}" if rest else ""
    return Verdict(True, f"better than {hardest}: {numbers}{rest}")


def regression(judgements: pa.Table, rivals: Mapping[str, str], name: str) -> str:
    """Return a sentence if what is in use is worse than any of ``rivals`` beyond noise, else "".

    That is, the lifting ``before``, called ``name``: clips that arrived since may show what those
    it was put to use by did not.
    """
    if "before" not in judgements["lifting"].to_pylist():
        return ""
    gains = _gains(judgements, rivals, "before")
    worse = [rival for rival, gain in gains.items() if gain.samples >= LEAST and gain.high < 0]
    if not worse:
        return ""
    worst = min(worse, key=lambda rival: gains[rival].difference)
    return f"{name}, in use, is worse than {worst}: {_describe(gains[worst])}"


def _gains(judgements: pa.Table, rivals: Mapping[str, str], lifting: str) -> dict[str, Comparison]:
    """Compare a lifting with each of the rivals that were judged, by their names."""
    judged = set(judgements["lifting"].to_pylist())
    return {
        name: gain(judgements, rival, of=lifting)
        for rival, name in rivals.items()
        if rival in judged
    }


def _describe(comparison: Comparison) -> str:
    return (
        f"{comparison.difference:+.4f} IoU ({comparison.low:+.4f} to {comparison.high:+.4f} in "
        f"{100 * LEVEL:.0f} % of the resamplings) on {comparison.samples} held-out clips"
    )
