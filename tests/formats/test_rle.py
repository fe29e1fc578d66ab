"""Run lengths of masks: what pycocotools 2.0.11 writes, a plain reference, and damaged ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from slgaussian.formats import rle
from tests.run_lengths import encode

SMALL = np.array([[1, 0, 0, 0, 0, 0], [0, 0, 1, 1, 1, 0], [0, 0, 1, 1, 1, 0], [0, 0, 0, 0, 0, 1]])
LARGE = np.zeros((2000, 3000), bool)
LARGE[0, 0] = LARGE[1999, 2999] = LARGE[500:700, 1000:1002] = True

masks = arrays.arrays(bool, arrays.array_shapes(min_dims=2, max_dims=2, max_side=40))


def plain(mask: np.ndarray) -> list[int]:
    """The counts, a pixel at a time."""
    counts, inside = [0], False
    for column in mask.T:
        for pixel in column:
            if pixel != inside:
                counts.append(0)
                inside = not inside
            counts[-1] += 1
    return counts


def plain_text(counts: list[int]) -> str:
    """The same as text, after `rleToString` of maskApi.c."""
    text = ""
    for i, count in enumerate(counts):
        x, more = count - (counts[i - 2] if i > 2 else 0), True
        while more:
            c = x & 0x1F
            x >>= 5
            more = x != -1 if c & 0x10 else x != 0
            text += chr((c | 0x20 if more else c) + 48)
    return text


def test_the_text_is_that_of_pycocotools():
    # mask.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]
    assert encode(SMALL) == "0181J0002O"
    assert encode(LARGE) == "01ccQm1W6eTPSN0[kmi3iI"
    assert np.array_equal(rle.decode("0181J0002O", *SMALL.shape), SMALL)
    assert np.array_equal(rle.decode("01ccQm1W6eTPSN0[kmi3iI", *LARGE.shape), LARGE)


@given(masks)
def test_text_and_list_are_of_the_plain_counts_and_come_back(mask):
    counts = plain(mask)
    text = encode(mask)
    assert text == plain_text(counts)
    assert np.array_equal(rle.decode(text, *mask.shape), mask)
    assert np.array_equal(rle.decode(counts, *mask.shape), mask)


@given(st.text(st.characters(codec="ascii"), max_size=12) | st.lists(st.integers(), max_size=6))
def test_any_counts_are_a_mask_or_a_reason(counts):
    try:
        assert rle.decode(counts, 3, 4).shape == (3, 4)
    except ValueError as bad:
        assert str(bad).startswith("its counts ")


@pytest.mark.parametrize(
    ("counts", "why"),
    [
        ("0181J0002", "23 pixels, expected 24"),
        ("0181J0002o", "end within a number"),
        ("0181 0002O", "invalid character ' '"),
        ("p" * 9, "invalid character 'p'"),
        ("o" * 9 + "0", "larger than any image"),
        ("81J", "not run lengths"),  # 8, 1, -6
        ([0, 25], "25 pixels, expected"),
        ([25, -1], "not run lengths"),
        ([12.0, 12], "not run lengths"),
        ([True] * 24, "not run lengths"),
        (24, "not run lengths"),
        (None, "not run lengths"),
    ],
)
def test_what_is_wrong_is_said(counts, why):
    with pytest.raises(ValueError, match=why):
        rle.decode(counts, 4, 6)
