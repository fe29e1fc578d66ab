"""Rendered codes back to ids, mixtures at borders above all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.language.bank import MemoryBank
from slgaussian.language.codes import checkerboard, grid_codes
from slgaussian.semantic.decode import Decoder, NearestCode, decoder_of

# Written out, not imported: a slip in the module must show here.
AGREE, CLOSE, REACH, VISIBLE = 4, 0.25, 2, 0.5

CODES = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], np.float32)


def bank(codes=CODES) -> MemoryBank:
    n = len(codes)
    features = np.zeros((n, 1, 4), np.float32)
    features[..., 0] = 1
    return MemoryBank(np.arange(3, 3 + n, dtype=np.int32), codes, features, np.ones((n, 1), bool))


def image(codes: np.ndarray, weight: float | np.ndarray = 1.0) -> np.ndarray:
    full = np.broadcast_to(weight, codes.shape[:-1])[..., None]
    return np.concatenate([codes * full, full], -1).astype(np.float32)


def plain(features: np.ndarray, bank: MemoryBank) -> tuple[np.ndarray, np.ndarray]:
    """What the decoder promises, pixel by pixel in float64, every code compared."""
    codes = bank.codes.astype(np.float64)
    height, width = features.shape[:2]
    weight = features[..., -1]
    visible = weight >= VISIBLE
    safe = np.where(visible, weight, np.float32(1))[..., None]
    values = (features[..., :-1] / safe).astype(np.float64)
    apart = np.abs(codes[:, None] - codes).sum(-1) + np.where(np.eye(len(codes)), np.inf, 0)
    rows, near = np.full((height, width), -1), np.full((height, width), -1)
    lead = np.zeros((height, width))
    for pixel in np.argwhere(visible):
        far = sum(np.abs(values[*pixel, k] - codes[:, k]) for k in range(codes.shape[1]))
        rows[*pixel] = far.argmin()
        share = far.min() / apart[far.argmin()].min()
        lead[*pixel] = max(0, 1 - 2 * share)
        if share <= CLOSE:
            near[*pixel] = far.argmin()
    settled = np.full((height, width), -1)
    for v, u in np.argwhere(near >= 0):
        around = near[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
        if (around == near[v, u]).sum() >= AGREE:
            settled[v, u] = near[v, u]
    ids, confidence = np.zeros((height, width), int), np.zeros((height, width))
    for v, u in np.argwhere(visible):
        row, sure = rows[v, u], lead[v, u]
        around = settled[max(0, v - REACH) : v + REACH + 1, max(0, u - REACH) : u + REACH + 1]
        choice = np.unique(around[around >= 0])
        if settled[v, u] < 0 and len(choice):
            far = sum(np.abs(values[v, u, k] - codes[choice, k]) for k in range(codes.shape[1]))
            order = np.argsort(far, kind="stable")
            sure = sure if choice[order[0]] == row else 0
            row = choice[order[0]]
            if len(choice) > 1:
                near_by, next_one = far[order[:2]]
                sure = (next_one - near_by) / (next_one + near_by)
        ids[v, u] = bank.ids[row]
        confidence[v, u] = min(weight[v, u], 1) * sure
    return ids, confidence


def borders(seed: int, n: int, size=(40, 30)) -> tuple[np.ndarray, MemoryBank]:
    """A picture of patches with blurred borders, noise, thin and empty places."""
    rng = np.random.default_rng(seed)
    codes = grid_codes(n, rng)
    if seed % 2:  # as on a chessboard, where the next code in L1 is not the next in L2
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
def test_the_decoder_does_what_it_says(seed, n):
    """Ids exactly; confidence to float32 rounding, measured 1.2e-7."""
    features, mine = borders(seed, n)
    ids, confidence = Decoder(mine)(features)
    wanted_ids, wanted = plain(features, mine)
    np.testing.assert_array_equal(ids, wanted_ids)
    np.testing.assert_allclose(confidence, wanted, atol=5e-7)
    assert confidence.min() >= 0
    assert confidence.max() <= 1
    assert (confidence[ids == 0] == 0).all()


def test_a_mixture_of_two_objects_is_not_taken_for_a_third():
    """Between code 0 and code 1 lies code 2, nearest to the mixtures, an object not there."""
    share = np.array([0, 0, 0, 0.3, 0.7, 1, 1, 1])[None, :, None].repeat(3, 0)
    mixed = image((1 - share) * CODES[0] + share * CODES[1])
    ids, confidence = Decoder(bank())(mixed)
    np.testing.assert_array_equal(ids, [[3, 3, 3, 3, 4, 4, 4, 4]] * 3)
    # As sure as the larger part leads the smaller.
    np.testing.assert_allclose(confidence[:, 3:5], 0.4, atol=1e-6)


@pytest.mark.parametrize("decoder", [Decoder, NearestCode])
def test_what_is_no_number_and_another_dimension_are_refused(decoder):
    nothing = decoder(bank(np.zeros((0, 3), np.float32)))
    assert not any(array.any() for array in nothing(image(np.zeros((2, 2, 3)))))
    features = image(CODES[np.zeros((70, 5), int)])
    with pytest.raises(InputError, match=r"expected \[H, W, 4\]"):
        decoder(bank())(features[..., :3])
    features[60, 2, 2] = np.nan
    with pytest.raises(InputError, match="hold NaN"):
        decoder(bank())(features)


@pytest.mark.parametrize("seed", range(3))
def test_the_papers_decoding_is_the_nearest_code_of_what_is_drawn(seed):
    features, mine = borders(seed, 20)
    features[5:10, 5:10] *= 0.7
    ids, confidence = NearestCode(mine)(features)
    codes = mine.codes.astype(np.float64)
    for pixel in np.ndindex(*ids.shape):
        code, weight = features[*pixel, :-1].astype(np.float64), features[*pixel, -1]
        if weight < VISIBLE:
            assert (ids[pixel], confidence[pixel]) == (0, 0)
            continue
        far = np.abs(codes - code).sum(1)
        apart = np.sort(np.abs(codes - codes[far.argmin()]).sum(1))[1]
        assert ids[pixel] == mine.ids[far.argmin()]
        lead = max(0, 1 - 2 * far.min() / apart) * min(weight, 1)
        assert confidence[pixel] == pytest.approx(lead, abs=1e-6)


def test_a_field_is_decoded_as_its_codes_say():
    assert isinstance(decoder_of(bank(), {"codes": "separated"}), Decoder)
    assert isinstance(decoder_of(bank(), {"codes": "grid", "grid": {}}), Decoder)
    paper = {"codes": "grid", "grid": {"decode": "nearest"}}
    assert isinstance(decoder_of(bank(), paper), NearestCode)
