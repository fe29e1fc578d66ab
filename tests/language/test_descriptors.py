"""Evidence of surfaces and of places in the room, from known measurements."""

import numpy as np
import pytest

from slgaussian.geometry.room import Surroundings
from slgaussian.language import descriptors
from slgaussian.language.descriptors import ROOM, SURFACES


@pytest.mark.parametrize("two_tone", [0.7, 0.75, 0.78])
def test_striped_evidence_rises_with_two_tone_variance(two_tone):
    """Two tones 40 apart, each in halves: of the variance 20^2 + off^2 they explain 20^2."""
    off = 20 * np.sqrt(1 / two_tone - 1)
    row = np.tile(np.repeat([20 + off, 20 - off, -20 + off, -20 - off], 5), 5)
    lab = np.zeros((60, 104, 3), np.float32)
    lab[..., 0] = 50 + np.pad(row, 2, mode="edge")  # two pixels along the outline are left out
    evidence = descriptors._surface(lab, np.ones((60, 104), bool), np.ones(1))
    striped = evidence[SURFACES.index("striped")]
    assert striped == pytest.approx((two_tone - 0.7) / 0.1, abs=1e-4)


@pytest.mark.parametrize("share", [0.3, 0.55, 0.8])
def test_sheer_evidence_rises_with_the_share_of_upright_surfaces(share):
    level = np.ones((10, 20))
    level.ravel()[: round(share * level.size)] = 0.0
    nowhere = np.full((10, 20), np.nan)
    around = Surroundings(level=level, height=nowhere, points=np.full((10, 20, 3), np.nan))
    evidence = descriptors._room(np.ones((10, 20), bool), np.s_[:, :], around)
    assert evidence[ROOM.index("sheer")] == pytest.approx((share - 0.55) / 0.25, abs=1e-9)
