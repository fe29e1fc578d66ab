"""Votes of views on the objects of Gaussians that are of no pixel."""

import numpy as np
import pytest
from scipy import sparse

from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank
from slgaussian.semantic.votes import elect, vote
from tests.pinhole import camera


@pytest.mark.parametrize(
    ("weights", "winner", "share"),
    [
        ([0, 0, 3, 1], 2, 0.75),
        ([9, 0, 1, 0], 2, 1),  # no object never wins over one
        ([9, 0, 0, 0], 0, 0),
        ([0, 0, 0, 0], 0, 0),
        ([0, 2, 0, 2], 1, 0.5),  # of equal weights the lowest
    ],
)
def test_elect_takes_the_object_with_the_largest_weight(weights, winner, share):
    winners, shares = elect(sparse.csr_array(np.array([[1, 0, 0, 0], weights], np.float64)))
    assert (winners[1], shares[1]) == (winner, np.float32(share))
    assert (winners[0], shares[0]) == (0, 0)


def test_vote_gives_codes_times_shares_and_nothing_to_what_no_view_shows():
    # A small Gaussian in the left half, one in the right half, one in both, and one behind.
    means = np.array([[-0.5, 0, 2], [0.5, 0, 2], [0.0, 0.4, 2], [0, 0, -2]], np.float32)
    gaussians = Gaussians(
        means=means,
        scales=np.full((4, 3), 0.03, np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (4, 1)),
        opacities=np.full(4, 0.9, np.float32),
        sh=np.zeros((4, 1, 3), np.float32),
        source=np.full(4, -1, np.int32),
    )
    labels = np.zeros((1, 24, 32), np.int32)
    labels[0, :, :16], labels[0, :, 16:] = 7, 900_001
    codes = np.array([[0.25, 0.5, 0.75], [1, 0, 0]], np.float32)
    present = np.ones((2, 1), bool)
    bank = MemoryBank(np.int32([7, 900_001]), codes, np.ones((2, 1, 4), np.float32) / 2, present)
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    features = vote(gaussians, maps, bank, [camera()]).to_arrays()["features"]
    np.testing.assert_allclose(features[:2], np.c_[codes, [1, 1]], atol=1e-6)
    assert features[2, 3] == pytest.approx(0.5, abs=0.01)
    assert not features[3].any()
