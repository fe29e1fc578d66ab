"""Significance tests on the evaluations of liftings, including the gate for retrained weights."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.statistics import CONFIDENCE_LEVEL, MIN_SAMPLES, Comparison, compare
from slgaussian.errors import InputError


@dataclass(frozen=True)
class Verdict:
    """Decision whether a gain is significant, and a sentence with the numbers."""

    better: bool
    reason: str


def clip_scores(judgements: pa.Table) -> dict[str, list[float]]:
    """Return the mean IoU of every lifting, in the order of the table, on every clip, sorted.

    Lessons of one clip are not independent, so a clip is one sample. ``judgements`` is a table of
    this spec. Clips without any object are left out.
    """
    by_clip: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in judgements.to_pylist():
        if row["iou"] is not None:
            by_clip[row["lifting"]][row["clip"]].append(row["iou"])
    return {
        lifting: [float(np.mean(scores[clip])) for clip in sorted(scores)]
        for lifting, scores in by_clip.items()
    }


def gain(judgements: pa.Table, rival: str, lifting: str = "branch") -> Comparison:
    """Compare a lifting with a rival; InputError without a clip."""
    scores = clip_scores(judgements)
    return compare(scores.get(lifting, []), scores.get(rival, []))


def gate(judgements: pa.Table, rivals: Mapping[str, str]) -> Verdict:
    """Decide whether ``branch`` may be promoted: if it is significantly better than each rival.

    The interval of the paired bootstrap against each of them must be above 0, with
    :data:`MIN_SAMPLES` clips or more. Each test is at the full level (an intersection-union test,
    Berger 1982). The sentence is about the rival with the smallest lower bound.

    Args:
        judgements: table of spec ``judgements``
        rivals: {lifting: its name in the sentence}. Rivals that were not evaluated are skipped;
            InputError if none was.
    """
    gains = _gains(judgements, rivals, "branch")
    if not gains:
        judged = sorted(set(judgements["lifting"].to_pylist()))
        raise InputError(f"judgements: found {judged}, expected one of {list(rivals)}")
    hardest = min(gains, key=lambda name: (gains[name].low, gains[name].difference))
    comparison = gains[hardest]
    numbers = _describe(comparison)
    if comparison.samples < MIN_SAMPLES:
        needed = f"{numbers}, {MIN_SAMPLES} needed"
        return Verdict(False, f"too few clips to tell it from {hardest}: {needed}")
    if comparison.high < 0:
        return Verdict(False, f"worse than {hardest}: {numbers}")
    if comparison.low <= 0:
        return Verdict(False, f"no gain over {hardest} beyond noise: {numbers}")
    other_names = " and ".join(name for name in gains if name != hardest)
    rest = f"; and than {other_names}" if other_names else ""
    return Verdict(True, f"better than {hardest}: {numbers}{rest}")


def regression(judgements: pa.Table, rivals: Mapping[str, str], name: str) -> str:
    """Return a sentence if the weights in use are significantly worse than a rival, else "".

    The weights in use are the lifting ``before``, named ``name`` in the sentence.
    """
    if "before" not in judgements["lifting"].to_pylist():
        return ""
    gains = _gains(judgements, rivals, "before")
    worse = [
        rival for rival, gain in gains.items() if gain.samples >= MIN_SAMPLES and gain.high < 0
    ]
    if not worse:
        return ""
    worst = min(worse, key=lambda rival: gains[rival].difference)
    return f"{name}, in use, is worse than {worst}: {_describe(gains[worst])}"


def _gains(judgements: pa.Table, rivals: Mapping[str, str], lifting: str) -> dict[str, Comparison]:
    """Compare a lifting with each evaluated rival, by their names."""
    judged = set(judgements["lifting"].to_pylist())
    return {
        name: gain(judgements, rival, lifting=lifting)
        for rival, name in rivals.items()
        if rival in judged
    }


def _describe(comparison: Comparison) -> str:
    return (
        f"{comparison.difference:+.4f} IoU ({comparison.low:+.4f} to {comparison.high:+.4f} in "
        f"{100 * CONFIDENCE_LEVEL:.0f} % of the resamplings) on {comparison.samples} held-out clips"
    )
