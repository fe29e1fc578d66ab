"""A proposer in one file: what is drawn in one of the colours that a file lists."""

from dataclasses import dataclass
from pathlib import Path

from slgaussian.errors import InputError
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

    def propose(self, image, *seen, **known):
        import numpy as np

        from slgaussian.masks import Proposals

        colours = np.loadtxt(self.colours, ndmin=2)
        masks = [np.linalg.norm(image - colour, axis=-1) <= self.within for colour in colours]
        masks = [mask for mask in masks if mask.sum() >= self.least]
        stack = np.array(masks, bool).reshape(-1, *image.shape[:2])
        return Proposals(stack, np.linspace(1, 0.5, len(stack), dtype=np.float32))
