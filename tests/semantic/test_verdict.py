"""Verdicts on judgements: paired by clip, and only with enough clips."""

import pyarrow as pa
import pytest

from slgaussian.benchmark.significance import clip_scores, gain, gate, regression
from slgaussian.benchmark.statistics import MIN_SAMPLES
from slgaussian.storage.specs import load_spec


def make_judgements(scores: dict[str, list[float | None]], clips: list[str], kinds=("as found",)):
    rows = [
        {"sample": f"s{k}", "clip": clip, "labels": kind, "lifting": name, "iou": values[k]}
        for k, clip in enumerate(clips)
        for kind in kinds
        for name, values in scores.items()
    ]
    return pa.Table.from_pylist(rows, schema=load_spec("judgements").schema)


def test_clip_scores_weight_clips_equally():
    table = make_judgements({"branch": [0.9, 0.7, 0.4], "hard": [0.5, 0.5, 0.5]}, ["a", "a", "b"])
    assert clip_scores(table)["branch"] == pytest.approx([0.8, 0.4])
    comparison = gain(table, "hard")
    assert comparison.samples == 2 and comparison.difference == pytest.approx(0.1)


def test_gate_rejects_a_gain_within_noise():
    """Weights are promoted only if the complete interval of the gain is above 0."""
    noise = [0.03, -0.03, 0.02, -0.02, 0.025, -0.025, 0.01, -0.01]  # standard error 0.0075
    verdicts = {}
    for step in (0.005, 0.01, 0.03):
        scores = {"branch": [0.5 + step + n for n in noise], "hard": [0.5] * 8}
        table = make_judgements(scores, list("abcdefgh"))
        verdict, comparison = gate(table, {"hard": "no branch"}), gain(table, "hard")
        assert comparison.difference > 0 and verdict.better == (comparison.low > 0)
        verdicts[step] = verdict
    assert [verdict.better for verdict in verdicts.values()] == [False, False, True]
    assert verdicts[0.01].reason.startswith(
        "no gain over no branch beyond noise: +0.0100 IoU (-0.00"
    )


@pytest.mark.parametrize("count", [MIN_SAMPLES - 1, MIN_SAMPLES])
def test_gate_needs_enough_clips(count):
    scores = {"branch": [0.9] * count, "hard": [0.1] * count}
    verdict = gate(make_judgements(scores, list("abcdefgh"[:count])), {"hard": "it"})
    assert verdict.better == (count == MIN_SAMPLES)
    assert verdict.better or verdict.reason.startswith("too few clips to tell it from it")


NOISE = [0.01, -0.01, 0.008, -0.008, 0.011, -0.011, 0.003, -0.003]
RIVALS = {"before": "version 1", "hard": "hard", "filled": "filled"}


def with_means(**means: float) -> pa.Table:
    """Judged on eight clips, each with noise of its own; ``None`` has none."""
    scores = {
        name: [mean + noise for noise in NOISE[shift:] + NOISE[:shift]]
        for shift, (name, mean) in enumerate(means.items())
    }
    return make_judgements(scores, list("abcdefgh"))


@pytest.mark.parametrize(
    ("before", "hard", "filled", "better", "why"),
    [
        # Better than the version in use, which was worse than no network.
        (0.55, 0.55, 0.6, False, "worse than filled: -0.02"),
        (0.55, 0.55, 0.579, False, "no gain over filled beyond noise: +0.001"),
        (0.6, 0.5, 0.5, False, "worse than version 1: "),
        (0.54, 0.5, 0.51, True, "better than version 1: +0.04"),
    ],
)
def test_gate_compares_with_the_best_rival(before, hard, filled, better, why):
    verdict = gate(with_means(branch=0.58, before=before, hard=hard, filled=filled), RIVALS)
    assert verdict.better == better and verdict.reason.startswith(why)
    assert verdict.reason.endswith("; and than hard and filled") == better


def test_regression_needs_a_significant_loss():
    rivals = {"hard": "hard", "filled": "filled"}
    reason = regression(
        with_means(branch=0.5, before=0.55, hard=0.5, filled=0.6), rivals, "version 1"
    )
    assert reason.startswith("version 1, in use, is worse than filled: -0.05")
    assert not regression(with_means(branch=0.5, before=0.6, hard=0.5, filled=0.601), rivals, "1")
    assert not regression(with_means(branch=0.5, hard=0.6, filled=0.6), rivals, "version 1")
    five_clips = make_judgements({"before": [0.1] * 5, "hard": [0.9] * 5}, list("abcde"))
    assert not regression(five_clips, rivals, "version 1")
