"""A proposer in one file: regions in the colours that a file lists."""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from slgaussian.components.config import ComponentConfig, File
from slgaussian.errors import InputError
from slgaussian.io import file_digest
from slgaussian.masks import Proposals


class Ink(ComponentConfig):
    """Propose a mask for each colour of a list, where the image is close to it."""

    colours: Annotated[Path | None, File(file_digest)] = Field(
        None, description="Colours, a line each: red green blue."
    )
    within: float = Field(40.0, ge=0, le=442, description="Greatest distance from a colour.")
    least: int = Field(20, ge=1, description="Fewest pixels of a mask.")

    def propose(self, frame, region=None):
        if self.colours is None:
            raise InputError("ink colours: none given; give a file of colours")
        allowed = True if region is None else region
        masks = [
            (np.linalg.norm(frame.image - colour, axis=-1) <= self.within) & allowed
            for colour in np.loadtxt(self.colours, ndmin=2)
        ]
        masks = [mask for mask in masks if mask.sum() >= self.least]
        stack = np.array(masks, bool).reshape(-1, *frame.image.shape[:2])
        return Proposals(stack, np.linspace(1, 0.5, len(stack), dtype=np.float32))
