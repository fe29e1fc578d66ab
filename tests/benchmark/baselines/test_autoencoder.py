"""The autoencoder of one scene reproduces its training vectors."""

import numpy as np
import torch

from slgaussian.benchmark.baselines.langsplat_like import train_autoencoder


def test_autoencoder_restores_vectors_deterministically():
    """Unit vectors of eight kinds, a little different within one."""
    rng = np.random.default_rng(0)
    kinds = np.arange(48) % 8
    vectors = rng.standard_normal((8, 58))[kinds] + 0.1 * rng.standard_normal((48, 58))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    vectors = vectors.astype(np.float32)
    state, threads = torch.random.get_rng_state(), torch.get_num_threads()
    network = train_autoencoder(vectors, seed=0, steps=300)
    codes = network.encode(vectors)
    assert codes.shape == (48, 3) and codes.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(codes, axis=1), 1, atol=1e-6)
    many = np.repeat(codes, 200, 0)
    decoded = network.decode(many)
    np.testing.assert_allclose(np.linalg.norm(decoded, axis=1), 1, atol=1e-5)
    cosines = (vectors * decoded[::200]).sum(1)
    assert cosines.mean() > 0.95 and cosines.min() > 0.8
    # Kinds stay apart.
    assert (kinds[(vectors @ decoded[::200].T).argmax(0)] == kinds).mean() > 0.95
    try:
        torch.set_num_threads(1)
        repeated = train_autoencoder(vectors, seed=0, steps=300)
        assert repeated.encode(vectors).tobytes() == codes.tobytes()
        assert repeated.decode(many).tobytes() == decoded.tobytes()
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(torch.random.get_rng_state(), state)
    other = train_autoencoder(vectors, seed=1, steps=5)
    assert other.encode(vectors).tobytes() != codes.tobytes()
