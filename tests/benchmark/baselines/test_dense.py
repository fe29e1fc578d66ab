"""Dense answers, compared with plain float64 formulas."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from slgaussian.benchmark.baselines.dense import DenseView, cosines
from slgaussian.kernels.work_sharing import share
from slgaussian.language import langsplat, load_encoder
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import TextReader
from tests.kernel_threads import kernels_on

# Written out, not imported: a slip in the module must show here.
BEST_SHARE, NEAR_BEST = 0.01, 0.6

SIZE = (40, 52)
TEXTS = ["red ball", "wooden floor", "blue box"]

NOISE = 2e-15
"""Sums of 58 products of numbers up to 1 in float64: measured 4e-16 between two orders of them."""


@pytest.fixture(scope="module")
def view() -> DenseView:
    """Vectors near those of texts, so that they compete, a hole and a zero vector."""
    reader = TextReader(load_encoder("lexicon"))
    rng = np.random.default_rng(0)
    texts = reader.vectors([*TEXTS, "object"])
    owner = rng.integers(len(texts), size=(SIZE[0] // 4, SIZE[1] // 4)).repeat(4, 0).repeat(4, 1)
    vectors = texts[owner] + 0.2 * rng.standard_normal((*SIZE, texts.shape[1]))
    vectors *= rng.uniform(0.1, 3, (*SIZE, 1))
    vectors[3, 4] = 0
    visible = np.ones(SIZE, bool)
    visible[10:14, 20:30] = False
    depth = np.ones(SIZE, np.float32)
    return DenseView(
        np.zeros((*SIZE, 3), np.uint8), depth, reader, visible, vectors.astype(np.float32)
    )


def plain_gap(view: DenseView, text: str, rivals: list[str] | None = None) -> np.ndarray:
    """Compute the gap in float64, pixel by pixel."""
    vectors = view.vectors.astype(np.float64)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    vectors = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)

    def cosine(words: str) -> np.ndarray:
        text = view.reader.vectors([words])[0].astype(np.float64)
        return vectors @ (text / np.linalg.norm(text))

    rivals = rivals or list(view.reader.encoder.canonical)
    return cosine(text) - np.max([cosine(rival) for rival in rivals], axis=0)


@pytest.mark.parametrize("rivals", [None, ["wall", "red box"]])
def test_dense_gaps_equal_the_formula(view, rivals):
    rules = Rules() if rivals is None else Rules(canonical=", ".join(rivals))
    gaps = view.gaps(TEXTS, rules)
    for text, gap in zip(TEXTS, gaps, strict=True):
        np.testing.assert_allclose(gap, plain_gap(view, text, rivals), atol=NOISE)
        assert gap[3, 4] == 0  # a zero vector says nothing


def test_cosines_are_equal_on_any_number_of_threads(view):
    flat, texts = view.vectors.reshape(-1, view.vectors.shape[2]), view.reader.vectors(TEXTS)
    actual = [np.empty((3, len(flat))) for _ in range(2)]
    for count, into in zip((1, 2), actual, strict=True):
        with kernels_on(count):
            share(cosines, len(flat), flat, texts.astype(np.float64), into)
    assert actual[0].tobytes() == actual[1].tobytes()


@pytest.mark.parametrize("text", TEXTS)
def test_dense_results_follow_the_rules(view, text):
    gap = plain_gap(view, text)
    relevancy = 1 / (1 + np.exp(-10 * gap))
    (hit,) = view.query_all([text])
    reach = NEAR_BEST * np.quantile(gap[view.seen], 1 - BEST_SHARE)
    assert np.array_equal(hit.mask, view.seen & (gap > 0) & (gap >= reach))
    assert 0 < hit.mask.sum() < view.seen.sum()
    np.testing.assert_allclose(hit.relevancy[view.seen], relevancy[view.seen], atol=1e-7)
    assert not hit.relevancy[~view.seen].any() and not hit.mask[~view.seen].any()
    assert hit.score == pytest.approx(relevancy[view.seen].max())
    # The point is where relevancy is greatest around.
    filled = np.where(view.seen, relevancy, relevancy[view.seen].min())
    smooth = langsplat.smooth(filled, langsplat.rescaled_filter(SIZE[1]))
    assert smooth[hit.point[::-1]] == pytest.approx(smooth[view.seen].max(), abs=1e-9)
    (hit,) = view.query_all([text], threshold=0.6)
    assert np.array_equal(hit.mask, view.seen & (relevancy > 0.6))


def test_dense_segment_chooses_the_best_text(view):
    gaps = [plain_gap(view, text) for text in TEXTS]
    expected = np.where(view.seen, np.argmax(gaps, 0) + 1, 0)
    assert np.array_equal(view.segment(TEXTS), expected)
    # Of equal texts the first.
    assert set(np.unique(view.segment(["red ball", "red ball"]))) == {0, 1}


def test_dense_gaps_interpolate_small_vectors(view):
    coarse = view.vectors[2::4, 2::4].copy()
    small = DenseView(view.rgb, view.depth, view.reader, view.seen, coarse)
    centres = [np.arange(length) * 4 + 2.0 for length in coarse.shape[:2]]
    rows, columns = (
        (np.arange(length) + 0.5).clip(at[0], at[-1])
        for length, at in zip(SIZE, centres, strict=True)
    )
    for text, gap in zip(TEXTS, small.gaps(TEXTS, Rules()), strict=True):
        plain = RegularGridInterpolator(centres, plain_gap(small, text))
        # OpenCV takes the shares of a row or column in float32.
        np.testing.assert_allclose(gap, plain(tuple(np.ix_(rows, columns))), atol=1e-6)
    assert small.query_all(TEXTS)[0].relevancy.shape == SIZE
