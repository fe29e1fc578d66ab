"""Random numbers that depend on what is computed, never on when, where or under which name."""

import hashlib
from collections.abc import Collection

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


def held_out(clip: str, fraction: float) -> bool:
    """Return whether a clip is kept to judge by, for good, and not learnt from.

    It depends on the key of the clip and on nothing else: a clip stays where it is when others
    arrive, all its samples are on one side, and a greater fraction keeps what a smaller one does.
    The key and not the content, which samples of one clip do not share; and no run's seed, or
    weights trained in one run would be judged in the next by what they have learnt from.

    Parameters
    ----------
    clip : str
        Its key.
    fraction : float
        Of all clips, in [0, 1], about: of few clips by chance more or fewer.
    """
    return seed_for(0, clip, "held out") < fraction * 2**64


def hold_out(clips: Collection[str], fraction: float) -> set[str]:
    """Return those of several clips that are :func:`held_out`.

    If chance holds out none and ``fraction`` is not 0, the one that a greater fraction would hold
    out first, unless there is no other.
    """
    chosen = {clip for clip in clips if held_out(clip, fraction)}
    if chosen or not fraction or len(clips) < 2:
        return chosen
    return {min(clips, key=lambda clip: seed_for(0, clip, "held out"))}
