"""Seeds derived from content, so that results do not depend on time, machine or names."""

import hashlib

import numpy as np


def seed_for(seed: int, content: str, stage: str) -> int:
    """Return a 64-bit seed, the same on every machine.

    Args:
        seed: Seed of the run.
        content: Digest of the scene by :func:`hash_arrays`, not its name. Empty for random numbers
            that belong to no scene.
        stage: Purpose of the random numbers.
    """
    digest = hashlib.sha256(f"{seed}\x1f{content}\x1f{stage}".encode()).digest()
    return int.from_bytes(digest[:8], "little")


def rng_for(seed: int, content: str, stage: str) -> np.random.Generator:
    """Return a NumPy generator with the seed of :func:`seed_for`."""
    return np.random.default_rng(seed_for(seed, content, stage))


def hash_arrays(*arrays: np.ndarray) -> str:
    """Return the SHA-256, hexadecimal, of the dtypes, shapes and values of ordered arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def held_out(place: str, fraction: float) -> bool:
    """Return whether a new place is held out, by its name.

    A larger fraction includes the places of a smaller one. It does not depend on content, which
    differs between samples of a place, nor on the seed of a run, as weights from one run would then
    be evaluated in another run on their own training places.

    Args:
        place: Name of the place.
        fraction: Expected fraction of held-out places, in [0, 1].
    """
    return seed_for(0, place, "held out") < fraction * 2**64
