"""The lexicon: a region and text encoder without weights, for an explicit vocabulary.

Every axis of the space is one descriptor (a colour, a pattern, an outline, a place ...). A region's
vector holds the evidence for each, in [-1, 1]; a text's vector is the sum of its words, each a
weighting of descriptors. Their product adds up evidence as a naive Bayes classifier adds up log
odds: every word of "red striped ball" speaks for or against a region, and what was not asked for is
silent. Two more axes make this work with cosines:

- *rest* takes up the length that a region's evidence leaves, so all regions have the same length
  before they are made unit vectors and their cosines compare;
- *neutral*, on which no region lies, is the direction of phrases that say nothing ("object"), so
  that relevancy is above 0.5 exactly if the evidence for a text outweighs that against it. It also
  takes up the length that a text's words leave. A word's weights sum to 1, so one that spreads them
  over many habits ("picture") lies nearer to "object" than one that asks for a single measurement,
  and does not outbid a text that says more: relevancies of different texts compare.

What cannot be seen is not claimed: an unknown word is left out and named, never guessed. The words
and how each is measured are listed in docs/reference/lexicon.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language.confidence import Calibration, Curve
from slgaussian.language.vocabulary import load_vocabulary

if TYPE_CHECKING:
    from slgaussian.geometry.room import Surroundings

REMEMBERED = 64
"""Texts whose reading is kept."""

POSITIVE = 0.8
"""Evidence for a descriptor counts this much of evidence against: one word that does not fit
outweighs one that does, so a red box is not, on balance, a red ball."""

SAYS = 0.5
"""Length, in a text's unit vector, of a word that asks for one descriptor: four such words fill it.
The order of objects for one text does not depend on it."""


@dataclass(eq=False)
class Lexicon:
    """Regions and texts by the words of an explicit vocabulary, without weights.

    See the module.
    """

    name: ClassVar[str] = "lexicon"
    calibration: ClassVar[Calibration] = Calibration(
        mask=Curve(6.71, 1.82, -1.81, -5.11), point=Curve(8.82, 1.18, -1.19, -4.09)
    )

    def __post_init__(self) -> None:
        from slgaussian.language.colours import ColourNames
        from slgaussian.language.descriptors import Descriptors

        self._vocabulary = load_vocabulary()
        self._descriptors = Descriptors(
            ColourNames(self._vocabulary.colours), self._vocabulary.groups
        )
        self._axis = {name: i for i, name in enumerate(self._descriptors.names)}
        self.canonical = self._vocabulary.canonical
        # Of one text several things are asked one after the other.
        self._read = lru_cache(REMEMBERED)(self._vocabulary.read)

    @property
    def width(self) -> int:
        """Number of axes C: the descriptors, then *rest*, then *neutral*."""
        return len(self._axis) + 2

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """Unit vectors of regions.

        Parameters
        ----------
        image : uint8 [H, W, 3]
            sRGB.
        masks : bool [M, H, W]
            The regions, each with at least one pixel; they may overlap.
        around : Surroundings, optional
            Where the pixels lie in the room. Without it, what a word asks of that is silent.

        Returns
        -------
        float32 [M, C]

        Raises
        ------
        InputError
            If image, masks and surroundings do not match, or a mask is empty.
        """
        from slgaussian.language.crops import check_regions

        check_regions(self.name, image, masks)
        if around is not None and around.height.shape != image.shape[:2]:
            raise InputError(
                f"lexicon: surroundings are {around.height.shape}, expected {image.shape[:2]}"
            )
        vectors = np.zeros((len(masks), self.width))
        if len(masks) == 0:
            return vectors.astype(np.float32)
        evidence = self._descriptors.measure(image, masks, around)
        axes = len(self._axis)
        vectors[:, :axes] = np.where(evidence > 0, POSITIVE * evidence, evidence) / np.sqrt(axes)
        vectors[:, axes] = np.sqrt(1 - (vectors**2).sum(1))
        return vectors.astype(np.float32)

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C] of texts.

        Raises
        ------
        InputError
            If a text is empty, has no known word or holds a negation.
        """
        vectors = np.zeros((len(texts), self.width))
        for vector, text in zip(vectors, texts, strict=True):
            for word in self._read(text).words:
                total = sum(abs(weight) for weight in word.weights.values())
                for name, weight in word.weights.items():
                    vector[self._axis[name]] += weight / total
            vector *= SAYS
            vector /= max(1.0, float(np.linalg.norm(vector)))
            vector[-1] = np.sqrt(max(0.0, float(1.0 - vector @ vector)))
        return vectors.astype(np.float32)

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that are not known; InputError as in :meth:`encode_text`."""
        return self._read(text).unknown

    def unused_words(self, text: str) -> Mapping[str, str]:
        """Other words of ``text`` that do not count, with the reason."""
        return self._read(text).unused

    def read_as(self, text: str) -> str:
        """The words of ``text`` that count, as the vocabulary spells them."""
        return " ".join(word.name for word in self._read(text).words)

    def measurements(self, text: str) -> int:
        """How many descriptors the words of ``text`` ask for."""
        words = self._read(text).words
        return len({name for word in words for name in word.weights})
