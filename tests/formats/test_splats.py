"""Every format of Gaussians, by the table of formats."""

import sys

import numpy as np
import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.formats.splats import READERS, WRITERS, load_gaussians, save_gaussians
from tests.formats.test_compact import make_gaussians

PACKAGES = {".rrd": "rerun", ".usda": "pxr", ".usdc": "pxr", ".usdz": "pxr"}
"""What writers import beyond the dependencies."""


@pytest.mark.parametrize("suffix", READERS)
def test_load_gaussians_reads_what_save_gaussians_wrote(tmp_path, suffix):
    gaussians = make_gaussians(50, degree=1)
    save_gaussians(gaussians, tmp_path / f"a{suffix.upper()}")
    restored, _ = load_gaussians(tmp_path / f"a{suffix.upper()}")
    assert (restored.means - gaussians.means).abs().max() < 1e-5
    assert (restored.sh - gaussians.sh).abs().max() < 0.05


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize(
    ("given", "labels", "sentence"),
    [
        ({"sh": torch.zeros(5, 25, 3)}, None, "found 25 coefficients a colour, expected 1, 4, 9"),
        ({"means": torch.full((5, 3), torch.nan)}, None, "means.*holds NaN"),
        ({}, np.zeros(4, int), r"labels: found int64 \(4,\), expected"),
    ],
)
def test_save_gaussians_refuses_and_leaves_no_file(tmp_path, suffix, given, labels, sentence):
    if suffix in PACKAGES:
        pytest.importorskip(PACKAGES[suffix], reason=f"{suffix} needs an extra")
    elif labels is not None:
        pytest.skip("has no place for labels, or not by default")
    arrays = dict(make_gaussians(5).items()) | given
    with pytest.raises(InputError, match=sentence):
        save_gaussians(type(make_gaussians(5))(**arrays), tmp_path / f"a{suffix}", labels)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("suffix", "package"), PACKAGES.items())
def test_save_gaussians_without_its_package_says_what_to_install(
    tmp_path, monkeypatch, suffix, package
):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=r"needs (rerun-sdk|usd-core) \d.* with `pip install"):
        save_gaussians(make_gaussians(3), tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []
