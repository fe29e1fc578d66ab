"""Random numbers that depend on what is computed, never on when or where."""

import hashlib

import numpy as np


def seed_for(seed: int, scene: str, stage: str) -> int:
    """A 64-bit seed from (run seed, scene id, stage), the same on every machine."""
    digest = hashlib.sha256(f"{seed}\x1f{scene}\x1f{stage}".encode()).digest()
    return int.from_bytes(digest[:8], "little")


def rng_for(seed: int, scene: str, stage: str) -> np.random.Generator:
    """A NumPy generator seeded by :func:`seed_for`."""
    return np.random.default_rng(seed_for(seed, scene, stage))
