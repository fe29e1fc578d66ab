"""Relevancy compared with the paper's formula, and its invariants."""

import numpy as np
import pytest
from drawn import relevancy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit

from slgaussian.language.scoring import Scorer, sigmoid


def normalize_rows(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return normalize_rows(rng.normal(size=shape))


def literal(features, present, queries, canonical, temperature):
    """max over views of min over canonical phrases of the exponential quotient, by loops."""
    out = np.zeros((len(queries), len(features)))
    for q, query in enumerate(queries):
        for n, views in enumerate(features):
            scores = [
                min(
                    np.exp(temperature * view @ query)
                    / (np.exp(temperature * view @ query) + np.exp(temperature * view @ canon))
                    for canon in canonical
                )
                for view, contents in zip(views, present[n], strict=True)
                if contents
            ]
            out[q, n] = max(scores, default=0.0)
    return out


@pytest.fixture
def case():
    rng = np.random.default_rng(7)
    present = rng.random((40, 3)) < 0.6
    present[0] = False
    features = unit(rng, 40, 3, 16) * present[..., None]
    return features, present, unit(rng, 5, 16), unit(rng, 4, 16)


@pytest.mark.parametrize("temperature", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("narrow", [0.0, 2.0], ids=["random directions", "a narrow cone"])
def test_relevancy_equals_the_paper_formula(case, narrow, temperature):
    """Off by at most a quarter of the errors of two cosines, times the temperature."""
    features, present, queries, canonical = case
    axis = np.eye(16)[0]
    features, queries, canonical = (
        normalize_rows(vectors + narrow * axis) for vectors in (features + 1e-9, queries, canonical)
    )
    expected = literal(features, present, queries, canonical, temperature)
    got = relevancy(features, present, queries, canonical, temperature)
    np.testing.assert_allclose(got, expected, rtol=0, atol=6e-16 * (1 + temperature))
    half = relevancy(features.astype(np.float16), present, queries, canonical, temperature)
    np.testing.assert_allclose(half, expected, rtol=0, atol=3e-4 * temperature)


def test_gaps_of_equal_objects_are_equal_in_any_order(case):
    features, present, queries, canonical = case
    order = np.random.default_rng(1).permutation(len(features))
    once = Scorer(features, present, canonical).gaps(queries)
    longer = (np.concatenate([array[:7], array[order]]) for array in (features, present))
    repeated = Scorer(*longer, canonical).gaps(queries[::-1])
    np.testing.assert_array_equal(repeated[::-1, 7:], once[:, order])


def test_absent_views_do_not_change_scores(case):
    features, present, queries, canonical = case
    got = relevancy(features, present, queries, canonical)
    assert (got[:, 0] == 0).all()
    assert (got[:, present.any(1)] > 0).all()
    # What stands in the row of an absent view must not matter, even NaN.
    poisoned = np.where(present[..., None], features, np.nan)
    np.testing.assert_array_equal(relevancy(poisoned, present, queries, canonical), got)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1, 1000))
def test_relevancy_order_does_not_depend_on_temperature(seed, temperature):
    """Order and sign do not depend on temperature; phrases never raise, views never lower it."""
    rng = np.random.default_rng(seed)
    features, queries, canonical = unit(rng, 12, 2, 8), unit(rng, 3, 8), unit(rng, 2, 8)
    present = rng.random((12, 2)) < 0.8
    gaps = Scorer(features, present, canonical).gaps(queries)
    scores = relevancy(features, present, queries, canonical, temperature)
    assert ((scores >= 0) & (scores <= 1)).all()
    order = np.argsort(gaps, axis=1, kind="stable")
    assert (np.diff(np.take_along_axis(scores, order, 1), axis=1) >= 0).all()
    visible = np.isfinite(gaps)
    np.testing.assert_array_equal(scores[visible] > 0.5, gaps[visible] > 0)
    fewer = relevancy(features, present, queries, canonical[:1], temperature)
    one_view = relevancy(features, present & [True, False], queries, canonical, temperature)
    assert (fewer >= scores).all() and (one_view <= scores).all()


def test_absent_zero_gives_at_least_half_to_absent_objects(case):
    features, present, queries, canonical = case
    skip, zero = (
        relevancy(features, present, queries, canonical, absent=how) for how in ("skip", "zero")
    )
    in_all_views = present.all(1)
    np.testing.assert_array_equal(zero[:, in_all_views], skip[:, in_all_views])
    np.testing.assert_array_equal(zero[:, ~in_all_views], np.maximum(skip, 0.5)[:, ~in_all_views])
    # The paper's bank, literally: a zero vector has cosine 0 with everything.
    literal_zero = literal(features * present[..., None], np.ones_like(present), *case[2:], 10)
    np.testing.assert_allclose(zero, literal_zero, rtol=1e-14)
    # Vectors are made unit.
    lengths = 1 + np.random.default_rng(0).uniform(-9e-4, 9e-4, present.shape)[..., None]
    np.testing.assert_allclose(
        relevancy(features * lengths, present, queries * 1.0009, canonical * 0.9991),
        skip,
        atol=1e-15,
    )


def sum_softly(features, present, queries, canonical, levels):
    """The gap over an object and its groups as the module has it, by loops.

    A lead that is 0.05 greater counts e times as much: chosen by measurement, written out here.
    """
    out = np.full((len(queries), levels.shape[1]), -np.inf)
    for q, query in enumerate(queries):
        for n in range(levels.shape[1]):
            leads = [
                features[row, v] @ query - max(features[row, v] @ canon for canon in canonical)
                for row in [n, *levels[:, n]]
                for v in np.flatnonzero(present[row])
            ]
            if leads:
                weights = [np.exp(lead / 0.05) for lead in leads]
                out[q, n] = np.average(leads, weights=weights)
    return out


@pytest.fixture
def nested_case():
    """Ten objects: 0-3 in group 10, 0-5 in group 11 above it, 9 alone; 8 and group 12 unseen."""
    rng = np.random.default_rng(3)
    present = rng.random((13, 3)) < 0.6
    present[[8, 12]] = False
    present[9] = True, False, False
    features = unit(rng, 13, 3, 16) * present[..., None]
    levels = np.tile(np.arange(10), (2, 1))
    levels[0, :4], levels[1, :6], levels[1, 7:9] = 10, 11, 12
    return features, present, unit(rng, 5, 16), unit(rng, 4, 16), levels


def test_gaps_with_groups_equal_the_formula(nested_case):
    features, present, queries, canonical, levels = nested_case
    got = Scorer(features, present, canonical, levels=levels).gaps(queries)
    # Sums of 9 leads below 2: the noise floor is some 1e-15.
    np.testing.assert_allclose(got, sum_softly(*nested_case), rtol=0, atol=1e-14)
    assert (got[:, 8] == -np.inf).all()
    alone = Scorer(features[:10], present[:10], canonical).gaps(queries)
    np.testing.assert_array_equal(got[:, 9], alone[:, 9])  # one view, no group: one lead
    zeros = Scorer(features, present, canonical, "zero", levels).gaps(queries)
    assert np.isfinite(zeros).all() and (zeros[:, 8] == 0).all()


@pytest.mark.parametrize("soft", [None, 0.01], ids=["a twentieth", "CLIP's own"])
def test_soft_maximum_weights_a_lead_larger_by_soft_e_times(soft):
    """By hand: leads of the object itself and of its group."""
    axes = np.eye(4)
    leads = np.array([0.30, 0.30 - (soft or 0.05)])
    features = leads[:, None] * axes[0] + np.sqrt(1 - leads**2)[:, None] * axes[2]
    options = {"levels": np.array([[1]])} | ({"soft": soft} if soft else {})
    scorer = Scorer(features[:, None], np.ones((2, 1), bool), axes[1:2], **options)
    expected = (np.e * leads[0] + leads[1]) / (np.e + 1)
    assert scorer.gaps(axes[:1])[0, 0] == pytest.approx(expected, abs=1e-12)


def test_sigmoid_equals_scipy_bitwise():
    rng = np.random.default_rng(0)
    ends = [0, -0.0, np.inf, -np.inf, 709.7, 709.8, -709.7, -709.8, -746, 1e-300]
    x = np.concatenate([rng.normal(0, 4, 4000), rng.uniform(-800, 800, 1000), ends])
    assert np.array_equal(sigmoid(x.reshape(10, -1)), expit(x).reshape(10, -1))
