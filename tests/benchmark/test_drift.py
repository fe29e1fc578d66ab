"""Drift of lessons: distances against SciPy, noise of clips, and what is no drift."""

import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import ks_2samp

from slgaussian.benchmark.drift import compare_lessons, find_drifts
from slgaussian.storage.specs import load_spec

SPEC = load_spec("distributions")
QUANTITIES = [name for name in SPEC.columns if name not in ("version", "clip")]


def lessons(clips, per_clip=3, shift=0.0, seed=0) -> pa.Table:
    """Return lessons whose blur varies from clip to clip, and hardly within one."""
    rows = []
    for clip in clips:
        rng = np.random.default_rng([seed, clip])
        blur = 0.3 + 0.1 * rng.standard_normal() + shift
        for _ in range(per_clip):
            values = dict.fromkeys(QUANTITIES, 0.5) | {
                "blur": float(np.clip(blur + 0.001 * rng.standard_normal(), 0, 1)),
                "objects": float(rng.integers(3, 9)),
            }
            rows.append({"version": 1, "clip": f"{clip:016x}", **values})
    return pa.Table.from_pylist(rows, schema=SPEC.schema)


def test_drift_distances_equal_scipy():
    then, now = lessons(range(20)), lessons(range(20, 50), shift=0.02)
    drift = compare_lessons(then, now)
    for name, distance in zip(drift["quantities"], drift["drifts"], strict=True):
        expected = ks_2samp(then[name].to_numpy(), now[name].to_numpy()).statistic
        assert distance == pytest.approx(expected, abs=1e-12), name
    assert all(0 <= low <= high <= 1 for low, high in
               zip(drift["drift_lows"], drift["drift_highs"], strict=True))  # fmt: skip


def test_drift_of_equal_lessons_is_zero():
    drift = compare_lessons(lessons(range(5)), lessons(range(5)))
    assert drift["drifts"] == [0] * len(QUANTITIES) and find_drifts(drift) == []


def test_drift_detects_a_few_different_clips():
    """A corpus that grows: all clips of the version, and new ones, which are alike or not."""
    then = lessons(range(40))
    alike = pa.concat_tables([then, lessons(range(40, 52))])
    blurred = pa.concat_tables([then, lessons(range(40, 52), shift=0.25)])
    assert find_drifts(compare_lessons(then, alike)) == []
    assert find_drifts(compare_lessons(then, blurred)) == ["blur"]


def test_drift_needs_several_clips():
    """By lessons alone, two times two clips with 200 lessons each would differ significantly."""
    then, now = lessons(range(2), 200), lessons(range(2, 4), 200)
    assert ks_2samp(then["blur"].to_numpy(), now["blur"].to_numpy()).pvalue < 1e-9
    assert find_drifts(compare_lessons(then, now)) == []


def test_drift_raises_few_false_alarms():
    alarms = [
        bool(
            find_drifts(compare_lessons(lessons(range(12), seed=s), lessons(range(12, 24), seed=s)))
        )
        for s in range(10)
    ]
    assert sum(alarms) <= 2  # 5 % expected at most
