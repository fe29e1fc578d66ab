"""Language side of a field: encoders of regions and texts, ID codes, memory bank and queries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import load_component

if TYPE_CHECKING:  # listing the components must not import torch
    import numpy as np

    from slgaussian.geometry.room import Surroundings
    from slgaussian.labels import LabelMaps
    from slgaussian.language.confidence import Calibration


TYPICAL_MEASUREMENTS = 6
"""Default number of measurements, used for taught words: the median over texts."""


@dataclass(frozen=True)
class Understood:
    """An encoder's reading of a text.

    Attributes:
        read_as: The words that count, in the encoder's spelling.
        unknown: Unknown words, which are ignored.
        unused: Other ignored words with the reason, such as "plant" of "plant pot".
        kind: What answers: ``known``, the encoder, which knows every word that counts; ``unknown``,
            the encoder without the unknown words; ``named``, the objects with this name;
            ``taught``, the examples of a taught word; ``picture``, no text but a picture or object.
        examples: Number of examples of a taught word.
        instead_of: For a name or a taught word, the encoder's reading of it, if it has one.
        measurements: Number of measurements that the text asks for, or the typical number.
        named: Evidence of the classifier; see :class:`slgaussian.language.confidence.Signs`.
        describing: Number of words that describe the noun.
        classes: ImageNet classes of the noun.
        untold: Reason why the text cannot be answered; empty if it can.
        question: Suggestions for unknown words, as the end of a sentence.
    """

    read_as: str
    unknown: tuple[str, ...]
    unused: Mapping[str, str]
    kind: str = "known"
    examples: int = 0
    instead_of: str = ""
    measurements: int = TYPICAL_MEASUREMENTS
    named: float = 0.0
    describing: int = 0
    classes: tuple[int, ...] = ()
    untold: str = ""
    question: str = ""

    @property
    def alone(self) -> str:
        """Note that unknown words are ignored, as the end of a sentence; empty without any."""
        return f", for {self.read_as!r} alone{self.question}" if self.unknown else ""


class Encoder(Protocol):
    """A region encoder and a text encoder that share one space of unit vectors.

    ``name`` identifies the encoder in every artifact and report row. ``canonical`` are the phrases
    that a query competes with (the paper's "object", "things", "stuff", "texture").
    ``calibration`` gives the probability that an answer is right; None if it was not measured.

    Optional members, see :class:`slgaussian.language.lexicon.Lexicon`: with a classifier,
    ``class_scores(image, masks)``; and ``soft``, the softmax temperature of
    :class:`slgaussian.language.relevancy.Scorer`, if its cosines spread less than the lexicon's.
    """

    name: str
    canonical: tuple[str, ...]
    calibration: Calibration | None

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """Encode the regions ``masks`` bool [M, H, W] of a uint8 image: unit vectors [M, C].

        float32. ``around`` gives the 3D positions of the pixels, for encoders that use them.
        """

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Encode texts as unit vectors float32 [Q, C]; InputError if one has no known word."""

    def understand(self, text: str, by_class: bool = False) -> Understood:
        """Return which words of ``text`` count, and what is known of it; errors as in encode_text.

        ``by_class`` is true if a classifier has classified the regions.
        """


def load_encoder(name: str = "lexicon", **settings: Any) -> Encoder:
    """Make the encoder called ``name``; raises InputError if there is none."""
    return load_component("encoder", name, settings)


class CodeStrategy(Protocol):
    """Assigns an ID code to every object of label maps (section 3.2)."""

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """Return distinct codes in [0, 1], float32 [N, 3], in the order of ``label_maps.ids``.

        ``rng`` is the only source of randomness. InputError if there is no object.
        """


def load_codes(name: str = "separated", **settings: Any) -> CodeStrategy:
    """Make the ID-code strategy called ``name``; raises InputError if there is none."""
    return load_component("codes", name, settings)
