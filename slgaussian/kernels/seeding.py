"""Random numbers that depend on what is computed, never on when, where or under which name."""

import hashlib

import numpy as np


def seed_for(seed: int, content: str, stage: str) -> int:
    """A 64-bit seed, the same on every machine.

    Parameters
    ----------
    seed : int
        Of the run.
    content : str
        What the scene is, as :func:`content_of` says it, never what it is called. Empty for what
        belongs to no scene.
    stage : str
        What it is drawn for.
    """
    digest = hashlib.sha256(f"{seed}\x1f{content}\x1f{stage}".encode()).digest()
    return int.from_bytes(digest[:8], "little")


def rng_for(seed: int, content: str, stage: str) -> np.random.Generator:
    """A NumPy generator seeded by :func:`seed_for`."""
    return np.random.default_rng(seed_for(seed, content, stage))


def content_of(*arrays: np.ndarray) -> str:
    """SHA-256, hexadecimal, of the types, shapes and values of arrays, in their order."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
