"""What a training of the branch is, besides its lessons."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from slgaussian.errors import InputError
from slgaussian.semantic.branch import Architecture


@dataclass(frozen=True)
class TrainingSettings:
    """What a training is, besides its lessons.

    Attributes
    ----------
    architecture : Architecture
    steps : int
    batch : int
        Lessons of a step, whose gradients are averaged.
    seed : int
    rate : float
        Highest learning rate, of AdamW.
    decay : float
        Its weight decay.
    clip : float
        Longest gradient; longer ones are shortened to it.
    targets : int
        Target views a step, chosen at random where a lesson has more.
    corrupted : float
        Fraction of the steps in which context labels are corrupted.
    codes : str
        Code strategy by name, as fields will have.
    every : int
        Steps between checkpoints.
    device : str
        Of the network, as PyTorch calls it.
    threads : int
        That PyTorch computes on; on it depend the last bits.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    architecture: Architecture = field(default_factory=Architecture)
    steps: int = 1500
    batch: int = 1
    seed: int = 0
    rate: float = 3e-3
    decay: float = 1e-4
    clip: float = 1.0
    targets: int = 2
    corrupted: float = 0.75
    codes: str = "separated"
    every: int = 100
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        bounds = {
            **dict.fromkeys(("steps", "batch", "targets", "every", "threads"), (1, math.inf)),
            **dict.fromkeys(("rate", "clip"), (1e-300, math.inf)),
            "decay": (0, math.inf),
            "corrupted": (0, 1),
        }
        for name, (least, most) in bounds.items():
            value = getattr(self, name)
            if not least <= value <= most or value == math.inf:
                raise InputError(
                    f"training {name}: found {value}, expected a number from {least} to {most}"
                )
