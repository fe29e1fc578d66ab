"""Words and regions in one space: encoders, ID codes, the memory bank, relevancy and queries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import load_component

if TYPE_CHECKING:  # the names of the parts are asked for where nobody waits for torch
    import numpy as np

    from slgaussian.geometry.room import Surroundings
    from slgaussian.labels import LabelMaps
    from slgaussian.language.confidence import Calibration

ENCODERS = {
    "lexicon": "slgaussian.language.configs:LexiconConfig",
    "clip": "slgaussian.language.configs:ClipConfig",
}
CODES = {
    "grid": "slgaussian.language.configs:GridConfig",
    "separated": "slgaussian.language.configs:SeparatedConfig",
    "exact": "slgaussian.language.codes:Exact",
}


class Encoder(Protocol):
    """A region encoder and a text encoder that share one space of unit vectors.

    ``name`` says what ran; it is written into every artifact and report row. ``canonical`` are the
    phrases that a query competes with (the paper's "object", "things", "stuff", "texture").
    ``calibration`` says how likely its answers are right, None where that was not measured.
    One with a calibration may have a method ``measurements(text)``: how many the text asks for, of
    which its evidence is the sum. One that names things by a classifier has methods
    ``class_scores(image, masks)``, ``classes(text)`` and ``describing(text)``, and one that knows
    when nothing can be said of a text ``untold(text, by_class)`` and ``question(text)``; see
    :class:`slgaussian.language.lexicon.Lexicon`. One whose cosines lie closer together than the
    lexicon's may have a number ``soft``, as :class:`slgaussian.language.relevancy.Scorer` takes it.
    """

    name: str
    canonical: tuple[str, ...]
    calibration: Calibration | None

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """Unit vectors float32 [M, C] of the regions ``masks`` bool [M, H, W] of a uint8 image.

        ``around`` says where its pixels lie in the room, for encoders that make use of it.
        """

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C]; InputError for an empty text or one without a known word."""

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that the encoder does not know and leaves out."""

    def unused_words(self, text: str) -> Mapping[str, str]:
        """Words of ``text`` that may be known and yet do not count, with the reason."""

    def read_as(self, text: str) -> str:
        """The part of ``text`` that is answered, in words of the encoder."""


def load_encoder(name: str = "lexicon", **settings: Any) -> Encoder:
    """Make the encoder called ``name``; raises InputError if there is none."""
    return load_component("encoder", name, settings)


class CodeStrategy(Protocol):
    """Gives every object of some label maps its ID code (section 3.2)."""

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """Distinct codes in [0, 1], float32 [N, D], one for each of ``label_maps.ids`` in order.

        D is 1 to 3, or 0 for none: then Gaussians carry the number of their object itself. What
        ``rng`` draws decides. InputError if there is no object.
        """


def load_codes(name: str = "separated", **settings: Any) -> CodeStrategy:
    """Make the ID-code strategy called ``name``; raises InputError if there is none."""
    return load_component("codes", name, settings)
