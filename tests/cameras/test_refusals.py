"""Photographs that tell no cameras are refused, and it is said why."""

import hard_photographs
import numpy as np
import pytest

from slgaussian.cameras.find import find_cameras
from slgaussian.errors import InputError


@pytest.mark.parametrize("case", hard_photographs.REFUSED)
def test_refused(case):
    make, said = hard_photographs.REFUSED[case]
    with pytest.raises(InputError, match=said):
        find_cameras(make())


@pytest.mark.parametrize("case", hard_photographs.ANSWERED)
def test_answered(case):
    found = find_cameras(hard_photographs.ANSWERED[case]())
    a, b = found.cameras.values()
    assert np.linalg.norm(b.center - a.center) == pytest.approx(1)
    assert b.center[0] > 0.98  # both pairs were taken side by side
