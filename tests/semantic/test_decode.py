"""Decoding of rendered codes to ids, mixtures at borders above all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.language.bank import MemoryBank
from slgaussian.language.codes import checkerboard, grid_codes
from slgaussian.semantic.decode import Decoder, NearestCode, make_decoder

# Not imported: an error in the module must show here.
AGREE, CLOSE, REACH, VISIBLE = 4, 0.25, 2, 0.5

CODES = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], np.float32)


def bank(codes=CODES) -> MemoryBank:
    n = len(codes)
    features = np.zeros((n, 1, 4), np.float32)
    features[..., 0] = 1
    return MemoryBank(np.arange(3, 3 + n, dtype=np.int32), codes, features, np.ones((n, 1), bool))


def image(codes: np.ndarray, weight: float | np.ndarray = 1.0) -> np.ndarray:
    weights = np.broadcast_to(weight, codes.shape[:-1])[..., None]
    return np.concatenate([codes * weights, weights], -1).astype(np.float32)


def reference(features: np.ndarray, bank: MemoryBank) -> tuple[np.ndarray, np.ndarray]:
    """Decode pixel by pixel in float64, comparing every code: ids and confidence."""
    codes = bank.codes.astype(np.float64)
    height, width = features.shape[:2]
    weight = features[..., -1]
    visible = weight >= VISIBLE
    safe = np.where(visible, weight, np.float32(1))[..., None]
    values = (features[..., :-1] / safe).astype(np.float64)
    separations = np.abs(codes[:, None] - codes).sum(-1) + np.where(np.eye(len(codes)), np.inf, 0)
    rows, near = np.full((height, width), -1), np.full((height, width), -1)
    lead = np.zeros((height, width))
    for pixel in np.argwhere(visible):
        distances = sum(np.abs(values[*pixel, k] - codes[:, k]) for k in range(codes.shape[1]))
        rows[*pixel] = distances.argmin()
        share = distances.min() / separations[distances.argmin()].min()
        lead[*pixel] = max(0, 1 - 2 * share)
        if share <= CLOSE:
            near[*pixel] = distances.argmin()
    agreed = np.full((height, width), -1)
    for v, u in np.argwhere(near >= 0):
        window = near[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
        if (window == near[v, u]).sum() >= AGREE:
            agreed[v, u] = near[v, u]
    ids, confidence = np.zeros((height, width), int), np.zeros((height, width))
    for v, u in np.argwhere(visible):
        row, certainty = rows[v, u], lead[v, u]
        window = agreed[max(0, v - REACH) : v + REACH + 1, max(0, u - REACH) : u + REACH + 1]
        candidates = np.unique(window[window >= 0])
        if agreed[v, u] < 0 and len(candidates):
            distances = sum(
                abs(values[v, u, k] - codes[candidates, k]) for k in range(codes.shape[1])
            )
            order = np.argsort(distances, kind="stable")
            certainty = certainty if candidates[order[0]] == row else 0
            row = candidates[order[0]]
            if len(candidates) > 1:
                first, second = distances[order[:2]]
                certainty = (second - first) / (second + first)
        ids[v, u] = bank.ids[row]
        confidence[v, u] = min(weight[v, u], 1) * certainty
    return ids, confidence


def borders(seed: int, n: int, size=(40, 30)) -> tuple[np.ndarray, MemoryBank]:
    """Return an image of patches with blurred borders, noise, and faint and empty pixels."""
    rng = np.random.default_rng(seed)
    codes = grid_codes(n, rng)
    if seed % 2:  # the nearest code in L1 is not the nearest in L2
        codes = rng.permutation(checkerboard(n))[:n]
    patches = codes[rng.integers(n, size=(size[0] // 8 + 1, size[1] // 8 + 1))]
    sharp = patches.repeat(8, 0).repeat(8, 1)[: size[0], : size[1]]
    soft = (sharp + np.roll(sharp, 1, 0) + np.roll(sharp, 1, 1) + np.roll(sharp, 2, 1)) / 4
    soft += rng.normal(0, 0.01, soft.shape)
    weight = rng.choice([0.0, 0.49, 0.5, 0.9, 1.0, 1.0000001], size)
    weight[weight < 0.9] *= rng.random() < 0.5
    return image(soft, weight), bank(codes)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_decoder_equals_the_float64_reference(seed, n):
    """Ids are equal; confidence agrees to float32 rounding, measured 1.2e-7."""
    features, codes = borders(seed, n)
    ids, confidence = Decoder(codes)(features)
    expected_ids, expected_confidence = reference(features, codes)
    np.testing.assert_array_equal(ids, expected_ids)
    np.testing.assert_allclose(confidence, expected_confidence, atol=5e-7)
    assert confidence.min() >= 0
    assert confidence.max() <= 1
    assert (confidence[ids == 0] == 0).all()


def test_decoder_assigns_no_third_object_to_a_mixture():
    """Code 2 lies between codes 0 and 1, nearest to their mixtures."""
    share = np.array([0, 0, 0, 0.3, 0.7, 1, 1, 1])[None, :, None].repeat(3, 0)
    mixed = image((1 - share) * CODES[0] + share * CODES[1])
    ids, confidence = Decoder(bank())(mixed)
    np.testing.assert_array_equal(ids, [[3, 3, 3, 3, 4, 4, 4, 4]] * 3)
    # The lead of the larger part over the smaller.
    np.testing.assert_allclose(confidence[:, 3:5], 0.4, atol=1e-6)


@pytest.mark.parametrize("decoder", [Decoder, NearestCode])
def test_decoder_refuses_nan_and_wrong_shapes(decoder):
    empty = decoder(bank(np.zeros((0, 3), np.float32)))
    assert not any(array.any() for array in empty(image(np.zeros((2, 2, 3)))))
    features = image(CODES[np.zeros((70, 5), int)])
    with pytest.raises(InputError, match=r"expected \[H, W, 4\]"):
        decoder(bank())(features[..., :3])
    features[60, 2, 2] = np.nan
    with pytest.raises(InputError, match="hold NaN"):
        decoder(bank())(features)


@pytest.mark.parametrize("seed", range(3))
def test_nearest_code_decodes_each_pixel_by_itself(seed):
    features, bank = borders(seed, 20)
    features[5:10, 5:10] *= 0.7
    ids, confidence = NearestCode(bank)(features)
    codes = bank.codes.astype(np.float64)
    for pixel in np.ndindex(*ids.shape):
        code, weight = features[*pixel, :-1].astype(np.float64), features[*pixel, -1]
        if weight < VISIBLE:
            assert (ids[pixel], confidence[pixel]) == (0, 0)
            continue
        distances = np.abs(codes - code).sum(1)
        nearest = distances.argmin()
        separation = np.sort(np.abs(codes - codes[nearest]).sum(1))[1]
        assert ids[pixel] == bank.ids[nearest]
        lead = max(0, 1 - 2 * distances[nearest] / separation) * min(weight, 1)
        assert confidence[pixel] == pytest.approx(lead, abs=1e-6)


def test_decoder_depends_on_the_settings_of_codes():
    assert isinstance(make_decoder(bank(), {"codes": "separated"}), Decoder)
    assert isinstance(make_decoder(bank(), {"codes": "grid", "grid": {}}), Decoder)
    paper = {"codes": "grid", "grid": {"decode": "nearest"}}
    assert isinstance(make_decoder(bank(), paper), NearestCode)
