"""Answers a pixel against plain float64 formulas."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from slgaussian.benchmark.baselines.dense import DenseView, cosines
from slgaussian.kernels.work_sharing import share
from slgaussian.language import langsplat
from slgaussian.language.reader import TextReader
from slgaussian.language.rules import Rules
from tests.kernel_threads import kernels_on

# Written out, not imported: a slip in the module must show here.
BEST_SHARE, NEAR_BEST = 0.01, 0.6

SIZE = (40, 52)
TEXTS = ["red ball", "wooden floor", "blue box"]

NOISE = 2e-15
"""Sums of 58 products of numbers up to 1 in float64: measured 4e-16 between two orders of them."""


@pytest.fixture(scope="module")
def reader() -> TextReader:
    from slgaussian.language import load_encoder

    return TextReader(load_encoder("lexicon"))


def some_view(reader: TextReader, scales: int = 1, size=SIZE, classes=(), seed: int = 0):
    """Vectors near those of texts, so that they compete, a hole and a zero vector."""
    rng = np.random.default_rng(seed)
    texts = reader.vectors([*TEXTS, "object"])
    owner = rng.integers(len(texts), size=(scales, size[0] // 4, size[1] // 4))
    owner = owner.repeat(4, 1).repeat(4, 2)
    vectors = texts[owner] + 0.2 * rng.standard_normal((*owner.shape, texts.shape[1]))
    vectors *= rng.uniform(0.1, 3, (*owner.shape, 1))
    vectors[:, 3, 4] = 0
    seen = np.ones(SIZE, bool)
    seen[10:14, 20:30] = False
    picture = np.zeros((*SIZE, 3), np.uint8)
    depth = np.ones(SIZE, np.float32)
    return DenseView(picture, depth, reader, seen, vectors.astype(np.float32), classes)


def plain_gap(view: DenseView, text: str, rivals: list[str]) -> np.ndarray:
    """Of each scale, in float64, pixel by pixel."""
    vectors = view.vectors.astype(np.float64)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    vectors = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)

    def cosine(words: str) -> np.ndarray:
        text = view.reader.vectors([words])[0].astype(np.float64)
        return vectors @ (text / np.linalg.norm(text))

    return cosine(text) - np.max([cosine(rival) for rival in rivals], axis=0)


def test_gaps_are_those_of_the_formula(reader):
    view = some_view(reader)
    for text in TEXTS:
        expected = plain_gap(view, text, list(reader.encoder.canonical))[0]
        found = view.gap(text, Rules())
        np.testing.assert_allclose(found, expected, atol=NOISE)
        other = view.gap(text, Rules(canonical="wall, red box"))
        expected = plain_gap(view, text, ["wall", "red box"])[0]
        np.testing.assert_allclose(other, expected, atol=NOISE)
        assert view.gap(text, Rules())[3, 4] == 0  # a zero vector says nothing


def test_cosines_do_not_depend_on_the_number_of_threads(reader):
    view = some_view(reader)
    flat, texts = view.vectors.reshape(-1, view.vectors.shape[3]), reader.vectors(TEXTS)
    found = [np.empty((3, len(flat))) for _ in range(2)]
    for count, into in zip((1, 2), found, strict=True):
        with kernels_on(count):
            share(cosines, len(flat), flat, texts.astype(np.float64), into)
    assert found[0].tobytes() == found[1].tobytes()


def test_a_text_takes_the_scale_that_fits_it_best_where_something_is_known(reader):
    view = some_view(reader, scales=3)
    chosen = set()
    for text in TEXTS:
        gaps = plain_gap(view, text, list(reader.encoder.canonical))
        best = int(np.argmax([gap[view.seen].max() for gap in gaps]))
        chosen.add(best)
        np.testing.assert_allclose(view.gap(text, Rules()), gaps[best], atol=NOISE)
        (hit,) = view.query_all([text])
        assert hit.score == pytest.approx(1 / (1 + np.exp(-10 * gaps[best][view.seen].max())))
    assert len(chosen) > 1


def test_masks_follow_the_rules(reader):
    view = some_view(reader)
    for text in TEXTS:
        gap = plain_gap(view, text, list(reader.encoder.canonical))[0]
        relevancy = 1 / (1 + np.exp(-10 * gap))
        (hit,) = view.query_all([text])
        ranked = np.sort(gap[view.seen])
        reach = NEAR_BEST * np.quantile(ranked, 1 - BEST_SHARE)
        assert np.array_equal(hit.mask, view.seen & (gap > 0) & (gap >= reach))
        assert 0 < hit.mask.sum() < view.seen.sum()
        np.testing.assert_allclose(hit.relevancy[view.seen], relevancy[view.seen], atol=1e-7)
        assert not hit.relevancy[~view.seen].any() and not hit.mask[~view.seen].any()
        (hit,) = view.query_all([text], threshold=0.6)
        assert np.array_equal(hit.mask, view.seen & (relevancy > 0.6))


def test_the_point_is_where_relevancy_is_greatest_around(reader):
    view = some_view(reader)
    for text in TEXTS:
        gap = plain_gap(view, text, list(reader.encoder.canonical))[0]
        filled = 1 / (1 + np.exp(-10 * gap))
        filled = np.where(view.seen, filled, filled[view.seen].min())
        smooth = langsplat.smoothed(filled, langsplat.rescaled_filter(SIZE[1]))
        (hit,) = view.query_all([text])
        x, y = hit.point
        assert smooth[y, x] == pytest.approx(smooth[view.seen].max(), abs=1e-9)


def test_segments_go_to_the_best_text(reader):
    view = some_view(reader)
    gaps = [plain_gap(view, text, list(reader.encoder.canonical))[0] for text in TEXTS]
    expected = np.where(view.seen, np.argmax(gaps, 0) + 1, 0)
    assert np.array_equal(view.segment(TEXTS), expected)
    # Of equal texts the first.
    assert set(np.unique(view.segment(["red ball", "red ball"]))) == {0, 1}


def test_a_closed_list_competes_with_itself(reader):
    view = some_view(reader, classes=tuple(TEXTS))
    for k, text in enumerate(TEXTS):
        others = [other for other in TEXTS if other != text]
        expected = plain_gap(view, text, others)[0]
        np.testing.assert_allclose(view.gap(text, Rules()), expected, atol=NOISE)
        (hit,) = view.query_all([text])
        assert np.array_equal(hit.mask, view.seen & (expected > 0))
        # All that it wins, where no pixel ties.
        assert np.array_equal(hit.mask, (view.segment(TEXTS) == k + 1) & (expected > 0))


def test_gaps_of_small_vectors_are_bilinear_between_their_pixels(reader):
    large = some_view(reader)
    few = large.vectors[:, 2::4, 2::4].copy()
    small = DenseView(large.rgb, large.depth, reader, large.seen, few)
    centres = [np.arange(length) * 4 + 2.0 for length in few.shape[1:3]]
    rows, columns = (
        (np.arange(length) + 0.5).clip(at[0], at[-1])
        for length, at in zip(SIZE, centres, strict=True)
    )
    for text in TEXTS:
        plain = plain_gap(small, text, list(reader.encoder.canonical))[0]
        expected = RegularGridInterpolator(centres, plain)(tuple(np.ix_(rows, columns)))
        # OpenCV takes the shares of a row or column in float32.
        np.testing.assert_allclose(small.gap(text, Rules()), expected, atol=1e-6)
        (hit,) = small.query_all([text])
        assert hit.relevancy.shape == SIZE and not hit.relevancy[~large.seen].any()
