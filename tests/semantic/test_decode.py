"""Rendered codes back to ids, mixtures at borders above all."""

import numpy as np
import pytest

from slgaussian.language.bank import MemoryBank
from slgaussian.semantic.decode import object_ids

CODES = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], np.float32)


def bank(codes=CODES) -> MemoryBank:
    n = len(codes)
    features = np.zeros((n, 1, 4), np.float32)
    features[..., 0] = 1
    return MemoryBank(np.arange(3, 3 + n, dtype=np.int32), codes, features, np.ones((n, 1), bool))


def image(codes: np.ndarray, weight: float = 1.0) -> np.ndarray:
    full = np.full((*codes.shape[:-1], 1), weight)
    return np.concatenate([codes * weight, full], -1).astype(np.float32)


def test_pure_codes_give_their_own_ids():
    rows = np.array([[0, 1, 2], [2, 2, 0]])
    np.testing.assert_array_equal(object_ids(image(CODES[rows]), bank()), rows + 3)


def test_a_mixture_of_two_objects_is_not_taken_for_a_third():
    """Between code 0 and code 1 lies code 2, nearest to both mixtures, an object not there."""
    share = np.array([0, 0, 0, 0.3, 0.7, 1, 1, 1])[None, :, None]
    mixed = image((1 - share) * CODES[0] + share * CODES[1])
    np.testing.assert_array_equal(object_ids(mixed, bank())[0], [3, 3, 3, 3, 4, 4, 4, 4])


def test_the_weight_says_what_is_an_object_and_does_not_pull_the_code():
    faint = object_ids(image(CODES[[[1, 1, 1]]], 0.6), bank())
    np.testing.assert_array_equal(faint, [[4, 4, 4]])
    assert object_ids(image(CODES[[[1, 1, 1]]], 0.4), bank()).max() == 0


def test_when_everything_is_mixed_the_nearest_code_is_all_there_is():
    grey = np.broadcast_to(np.array([0.2, 0.2, 0.2]), (2, 3, 3))
    assert (object_ids(image(grey), bank()) == 3).all()


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_one_object_alone(weight):
    alone = bank(np.array([[0.5, 0.5, 0.5]], np.float32))
    ids = object_ids(image(np.full((2, 2, 3), 0.4), weight), alone)
    assert (ids == (3 if weight else 0)).all()
