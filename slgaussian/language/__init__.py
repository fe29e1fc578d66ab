"""Words and regions in one space: encoders, ID codes, the memory bank, relevancy and queries."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from slgaussian.registry import resolve

ENCODERS = {"lexicon": "slgaussian.language.lexicon:Lexicon"}
CODES = {"grid": "slgaussian.language.codes:grid_codes"}


class Encoder(Protocol):
    """A region encoder and a text encoder that share one space of unit vectors.

    ``name`` says what ran; it is written into every artifact and report row. ``canonical`` are the
    phrases that a query competes with (the paper's "object", "things", "stuff", "texture").
    """

    name: str
    canonical: tuple[str, ...]

    def encode_regions(self, image: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Unit vectors float32 [M, C] of the regions ``masks`` bool [M, H, W] of a uint8 image."""

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C]; InputError for an empty text or one without a known word."""

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that the encoder does not know and leaves out."""


def load_encoder(name: str = "lexicon", **settings: Any) -> Encoder:
    """Make the encoder called ``name``; raises InputError if there is none."""
    return resolve("encoder", ENCODERS, name)(**settings)


def load_codes(name: str = "grid") -> Callable[[int, np.random.Generator], np.ndarray]:
    """The ID-code strategy called ``name``: from (N, generator) to distinct float32 [N, 3]."""
    return resolve("code strategy", CODES, name)
