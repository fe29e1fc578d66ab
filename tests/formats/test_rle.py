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


def test_counts_equal_those_of_pycocotools():
    # mask.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]
    assert encode(SMALL) == "0181J0002O"
    assert encode(LARGE) == "01ccQm1W6eTPSN0[kmi3iI"
    assert np.array_equal(rle.decode("0181J0002O", *SMALL.shape), SMALL)
    assert np.array_equal(rle.decode("01ccQm1W6eTPSN0[kmi3iI", *LARGE.shape), LARGE)


@given(masks)
def test_decode_inverts_encode_for_any_mask(mask):
    assert rle.encode(mask) == (*mask.shape, encode(mask))
    assert np.array_equal(rle.decode(encode(mask), *mask.shape), mask)


@given(arrays.arrays(np.int32, (7, 9), elements=st.integers(0, 3)))
def test_encode_ids_equals_encode_of_each_id(ids):
    expected = {int(i): rle.encode(ids == i) for i in np.unique(ids[ids > 0])}
    assert rle.encode_ids(ids) == expected


def test_decode_accepts_a_list_of_counts():
    counts = [0, 1, 8, 2, 0, 2, 0, 2, 0, 8, 1]
    mask = rle.decode(counts, 4, 6)
    assert mask.sum() == sum(counts[1::2]) and mask[0, 0]


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
        (None, "not run lengths"),
    ],
)
def test_decode_error_explains_invalid_counts(counts, why):
    with pytest.raises(ValueError, match=why):
        rle.decode(counts, 4, 6)
