"""Which clips are learnt from and which are kept to judge by, for good."""

from __future__ import annotations

from slgaussian.kernels.seeding import seed_for


def held_out(clip: str, fraction: float) -> bool:
    """Whether a clip is kept to judge by.

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
