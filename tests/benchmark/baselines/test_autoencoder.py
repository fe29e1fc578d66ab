"""The autoencoder of one scene gives back what it saw."""

import numpy as np
import pytest
import torch

from slgaussian.benchmark.baselines.langsplat_like import train_autoencoder


def some_vectors(count: int, width: int, kinds: int) -> np.ndarray:
    """Unit vectors of a few kinds, a little different within one."""
    rng = np.random.default_rng(0)
    centres = rng.standard_normal((kinds, width))
    vectors = centres[np.arange(count) % kinds] + 0.1 * rng.standard_normal((count, width))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def trained():
    vectors = some_vectors(48, 58, 8)
    return vectors, train_autoencoder(vectors, seed=0, steps=300)


def test_vectors_come_back(trained):
    vectors, network = trained
    codes = network.encode(vectors)
    assert codes.shape == (48, 3) and codes.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-6)
    back = network.decode(codes)
    np.testing.assert_allclose(np.linalg.norm(back, axis=1), 1, atol=1e-5)
    cosines = (vectors * back).sum(1)
    assert cosines.mean() > 0.95 and cosines.min() > 0.8
    # Kinds stay apart.
    assert ((vectors @ back.T).argmax(0) % 8 == np.arange(48) % 8).mean() > 0.95


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(trained):
    vectors, network = trained
    codes = network.encode(vectors)
    many = np.repeat(codes, 200, 0)
    once, before = network.decode(many), torch.get_num_threads()
    state = torch.random.get_rng_state()
    try:
        torch.set_num_threads(1)
        again = train_autoencoder(vectors, seed=0, steps=300)
        assert again.encode(vectors).tobytes() == codes.tobytes()
        assert again.decode(many).tobytes() == once.tobytes()
    finally:
        torch.set_num_threads(before)
    assert torch.equal(torch.random.get_rng_state(), state)
    other = train_autoencoder(vectors, seed=1, steps=5)
    assert other.encode(vectors).tobytes() != codes.tobytes()
