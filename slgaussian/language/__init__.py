"""Language side of a field: encoders of regions and texts, ID codes, memory bank and queries."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from slgaussian.components.registry import load_component, restore
from slgaussian.errors import InputError, SpecError

if TYPE_CHECKING:  # listing the components must not import torch
    import numpy as np

    from slgaussian.geometry.room import Surroundings
    from slgaussian.labels import LabelMaps
    from slgaussian.language.answer import Calibration
    from slgaussian.language.vocabulary import Vocabulary
    from slgaussian.language.wholes import Ranking

COMMON_OBJECTS = (
    "floor", "wall", "table", "chair", "sofa", "door", "window", "plant", "box", "book",
)  # fmt: skip
"""Texts for encoders without a vocabulary of their own."""

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
        named: Evidence of the classifier; see :class:`slgaussian.language.answer.Signs`.
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


class Encoder(ABC):
    """Base class of encoders of regions and texts, which share one space of unit vectors.

    ``encode_regions`` and ``encode_text`` are required, and so are ``name``, which identifies the
    encoder in every artifact and report row, and ``canonical``; the other abilities have defaults.

    Attributes:
        canonical: Phrases that a query competes with (the paper's "object", "things", "stuff",
            "texture").
        calibration: Gives the probability that an answer is right; None if it was not measured.
        ranking: Weights of the candidates of an answer. Without it, all near-best objects are the
            answer.
        soft: Temperature of the soft maximum over leads (:mod:`slgaussian.language.scoring`), which
            depends on the spread of the encoder's cosines.
        vocabulary: The known words, for an encoder that does not take any text.
        describing: Texts that describe objects without a query.
        classifies: Whether it classifies regions too.
        advice: How the encoder can be made to know more; empty if it cannot.
    """

    name: ClassVar[str]
    canonical: ClassVar[tuple[str, ...]]
    calibration: ClassVar[Calibration | None] = None
    ranking: ClassVar[Ranking | None] = None
    vocabulary: ClassVar[Vocabulary | None] = None

    @property
    def soft(self) -> float:
        """By default 0.05. Answers of the lexicon are about as good from 0.02 to 0.1."""
        return 0.05

    @property
    def describing(self) -> tuple[str, ...]:
        """By default the names of some common objects."""
        return COMMON_OBJECTS

    @property
    def classifies(self) -> bool:
        """True if :meth:`class_scores` can be called; by default False."""
        return False

    @property
    def advice(self) -> str:
        """By default empty."""
        return ""

    @abstractmethod
    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """Encode regions as unit vectors.

        Args:
            image: uint8 [H, W, 3]. sRGB.
            masks: bool [M, H, W]. The regions, each with at least one pixel; they may overlap.
            around: 3D positions of the pixels, for encoders that use them.

        Returns:
            float32 [M, C]
        """

    @abstractmethod
    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Encode texts as unit vectors float32 [Q, C]; InputError if one cannot be used."""

    def understand(self, text: str, by_class: bool = False) -> Understood:
        """Return which words of ``text`` count, by default all; errors as in encode_text.

        ``by_class`` is true if a classifier has classified the regions.
        """
        return Understood(text, (), {})

    def class_scores(self, image: np.ndarray, masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Classify regions and the whole photograph, if the encoder :attr:`classifies`.

        Returns:
            uint8 [M, 1000] and [1000], from :func:`slgaussian.language.classifier.quantize`.
        """
        raise NotImplementedError


def load_encoder(name: str = "lexicon", **settings: Any) -> Encoder:
    """Make the encoder called ``name``; raises InputError if there is none."""
    return load_component("encoder", name, settings)


def restore_encoder(settings: Mapping[str, Any], places: Mapping[str, str], width: int) -> Encoder:
    """Load the encoder that a field with these settings and places was built with.

    Raises:
        InputError: If one of its files is missing from ``places`` or has another content.
        SpecError: If its vectors have another ``width``.
    """
    component = restore("encoder", settings, places)
    for key, file in component.known_files.items():
        place = file.place
        if not place or (os.path.isabs(place) and not os.path.exists(place)):
            moved = f" and is no longer at {place}" if place else ""
            raise InputError(
                f"the field's encoder {component.name!r} needs its {key}, which is not stored with "
                f"a field{moved}; say where it is, as in --set {component.name}.{key}=PLACE or "
                f"SemanticField.load(..., encoder={{'{key}': PLACE}})"
            )
    encoder: Encoder = component.load(
        "is not what the field was built with; give that one, or build the field with it"
    )
    if width != encoder.encode_text(encoder.canonical).shape[1]:
        raise SpecError(
            f"memory bank: made by another version of the encoder {component.name!r}; build the "
            "field again"
        )
    return encoder


class CodeStrategy(Protocol):
    """Assigns an ID code to every object of label maps (section 3.2)."""

    def __call__(self, label_maps: LabelMaps, rng: np.random.Generator) -> np.ndarray:
        """Return distinct codes in [0, 1], float32 [N, 3], in the order of ``label_maps.ids``.

        ``rng`` is the only source of randomness. InputError if there is no object.
        """


def load_codes(name: str = "separated", **settings: Any) -> CodeStrategy:
    """Make the ID-code strategy called ``name``; raises InputError if there is none."""
    return load_component("codes", name, settings)
