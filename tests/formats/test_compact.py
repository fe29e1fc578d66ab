"""Round trips of compact formats, within their precision."""

import gzip

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.formats.spz import pack_quats, save_spz
from slgaussian.gaussians import Gaussians, rotation_matrices
from slgaussian.rasterize.harmonics import compute_colours
from slgaussian.scene import Camera
from tests.formats.spz_reader import load_spz, unpack_quats


def make_gaussians(n: int = 500, degree: int = 0, seed: int = 0, spread: float = 1.0) -> Gaussians:
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.15, (n, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.5, (n, 3))
    return Gaussians.from_arrays(
        {
            "means": (rng.normal(0, spread, (n, 3)) + (0, 0, 4 * spread)).astype(np.float32),
            "scales": (spread * np.exp(rng.uniform(-4, -2, (n, 3)))).astype(np.float32),
            "quats": rng.normal(size=(n, 4)).astype(np.float32),
            "opacities": rng.uniform(0.1, 1, n).astype(np.float32),
            "sh": sh.astype(np.float32),
            "source": np.arange(n, dtype=np.int32),
        }
    )


def angles(a: torch.Tensor, b: torch.Tensor) -> np.ndarray:
    """Degrees between rotations of quaternions wxyz."""
    R, Q = rotation_matrices(a.double()), rotation_matrices(b.double())
    trace = (R * Q).sum((-2, -1)).clamp(-1, 3)
    return np.degrees(np.arccos(((trace - 1) / 2).numpy()))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 4), min_size=1, max_size=20))
def test_pack_quats_keeps_rotations_within_a_third_of_a_degree(rows):
    quats = np.array(rows, np.float32)
    quats[np.linalg.norm(quats, axis=1) < 1e-3] = (0, 0, 0, 1)
    restored = unpack_quats(pack_quats(quats))
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    cosine = np.abs((unit.astype(np.float64) * restored).sum(1)).clip(0, 1)
    assert np.degrees(2 * np.arccos(cosine)).max() < 0.28
    np.testing.assert_allclose(np.linalg.norm(restored, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_round_trip_stays_within_its_precision(tmp_path, degree):
    gaussians = make_gaussians(degree=degree)
    save_spz(gaussians, tmp_path / "a.spz")
    restored = load_spz(tmp_path / "a.spz")
    assert (gaussians.means - restored.means).abs().max() < 2e-6 * gaussians.means.abs().max()
    assert (gaussians.scales / restored.scales).log().abs().max() < 0.501 / 16
    assert (gaussians.opacities - restored.opacities).abs().max() <= 0.501 / 255
    assert (gaussians.sh[:, 0] - restored.sh[:, 0]).abs().max() <= 0.501 / 255 / 0.15
    if degree:
        assert (gaussians.sh[:, 1:4] - restored.sh[:, 1:4]).abs().max() <= 5 / 128
        assert (gaussians.sh[:, 1:] - restored.sh[:, 1:]).abs().max() <= 9 / 128
    assert angles(gaussians.quats, restored.quats).max() < 0.28


def test_spz_turns_harmonics_with_the_axes(tmp_path):
    """Without the rotation, colours would be those of a mirrored direction."""
    gaussians = make_gaussians(20, degree=3, seed=3)
    save_spz(gaussians, tmp_path / "a.spz")
    restored = load_spz(tmp_path / "a.spz")
    cam = Camera(np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4), 64, 48)
    assert (compute_colours(gaussians, cam) - compute_colours(restored, cam)).abs().max() < 0.35
    data = bytearray(gzip.decompress((tmp_path / "a.spz").read_bytes()))
    stored = np.frombuffer(data, np.uint8)[16 + 20 * 20 :].reshape(20, 15, 3)
    # Degree 1 holds y, z and x: the first two are turned.
    signs = np.sign(stored[:, :3].astype(int) - 128) * np.sign(gaussians.sh[:, 1:4].numpy())
    assert (signs[:, :2] <= 0).all() and (signs[:, 2] >= 0).all()


def test_save_spz_writes_nothing_for_invalid_gaussians(tmp_path):
    gaussians = make_gaussians(5)
    gaussians.means[2, 1] = torch.nan
    with pytest.raises(InputError, match="NaN"):
        save_spz(gaussians, tmp_path / "a.bin")
    with pytest.raises(InputError, match="cannot be written"):
        save_spz(make_gaussians(5), tmp_path / "nowhere" / "a.bin")
    assert list(tmp_path.iterdir()) == []
