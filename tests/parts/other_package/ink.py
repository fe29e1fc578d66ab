"""A proposer in one file: what is drawn in one of the colours that a file lists."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slgaussian.errors import InputError
from slgaussian.masks import Proposals
from slgaussian.parts.identity import file_digest
from slgaussian.parts.settings import setting


@dataclass(frozen=True)
class Ink:
    """A mask for each colour of a list, where the image comes near it."""

    colours: Path | None = setting(
        None, "Colours, a line each: red green blue.", content=file_digest
    )
    within: float = setting(40.0, "Greatest distance from a colour.", low=0, high=442)
    least: int = setting(20, "Fewest pixels of a mask.", low=1)

    def __post_init__(self):
        if self.colours is None or not Path(self.colours).is_file():
            raise InputError(f"ink colours: found {self.colours}, expected a file of colours")

    def propose(self, seen, where=None):
        allowed = True if where is None else where
        masks = [
            (np.linalg.norm(seen.image - colour, axis=-1) <= self.within) & allowed
            for colour in np.loadtxt(self.colours, ndmin=2)
        ]
        masks = [mask for mask in masks if mask.sum() >= self.least]
        stack = np.array(masks, bool).reshape(-1, *seen.image.shape[:2])
        return Proposals(stack, np.linspace(1, 0.5, len(stack), dtype=np.float32))
