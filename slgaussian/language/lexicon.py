"""The lexicon: a region and text encoder for an explicit vocabulary, without trained weights.

Every axis of the space is one descriptor (a colour, pattern, outline, place ...). A region's vector
holds the evidence for each, in [-1, 1]; a text's vector is the sum over its words, each of which is
a set of weights of descriptors. The dot product sums evidence as a naive Bayes classifier sums
log-odds: every word of "red striped ball" is evidence for or against a region, and other
descriptors do not count. Two additional axes make cosines comparable:

- *rest* fills a region's vector up to length 1, so that evidence is not rescaled;
- *neutral*, which is 0 for all regions, is the direction of generic phrases ("object"), so that
  relevancy is above 0.5 exactly if the evidence for a text outweighs that against it. It also fills
  a text's vector up to length 1. A word's weights sum to 1, so a word with many weak descriptors
  ("picture") is nearer to "object" than one with a single descriptor, and does not win against a
  more specific text: relevancies of different texts are comparable.

Unknown words are ignored and reported, never guessed. docs/reference/lexicon.md lists the words and
their measurements. Nouns that appearance cannot describe are left to an ImageNet classifier
(:mod:`slgaussian.language.classifier`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language import Encoder, Understood
from slgaussian.language.answer import Calibration, Curve
from slgaussian.language.classifier import quantize
from slgaussian.language.configs import INSTALL, find_weights
from slgaussian.language.vocabulary import (
    NOUN_FAMILIES,
    Reading,
    Vocabulary,
    load_vocabulary,
    unusable,
)
from slgaussian.language.wholes import Ranking

if TYPE_CHECKING:
    from slgaussian.geometry.room import Surroundings

UNKNOWN_WORD_ADVICE = (
    "teach it by examples, or build the field with --encoder clip, which knows any word"
)
"""Advice for an unknown word."""

MAX_LISTED = 3
"""Largest number of unknown words that a message lists."""

CACHE_SIZE = 4096
"""Number of texts whose reading is cached."""

POSITIVE_WEIGHT = 0.8
"""Weight of evidence for a descriptor, relative to evidence against: one word that does not fit
outweighs one that does, so a red box does not count as a red ball."""

WORD_LENGTH = 0.5
"""Length, in a text's unit vector, of a word with one descriptor: four such words fill it. It does
not affect the order of objects for one text."""


@dataclass(eq=False)
class Lexicon(Encoder):
    """Encoder with an explicit vocabulary of words and measurements; see the module.

    Attributes:
        classifier: ``lite0`` to classify regions too (:mod:`slgaussian.language.classifier`); its
            weights are needed for regions, not for texts. Otherwise ``none``.
    """

    classifier: str = "none"
    name: ClassVar[str] = "lexicon"
    vocabulary: ClassVar[Vocabulary] = load_vocabulary()
    canonical: ClassVar[tuple[str, ...]] = vocabulary.canonical
    calibration: ClassVar[Calibration] = Calibration(
        mask=Curve(1.482, 1.426, -0.218, 0.275, -3.312),
        point=Curve(2.314, 1.252, -0.536, 0.45, -2.762),
    )

    ranking: ClassVar[Ranking] = Ranking(
        fit=1.56,
        around=-0.97,
        lead=17.1,
        recall=1.64,
        best=0.49,
        near_best=0.66,
        evidence=0.55,
        evidence_recall=0.87,
        size=0.40,
        outline=1.89,
        edge=-3.22,
        standing=1.36,
        agreement=1.02,
    )
    """Weights of a softmax over the candidates of a text, fitted to their IoU with the labels of 12
    places and 8 procedural rooms. ``python -m benches.language.fit_ranking DATA`` fits it anew, to
    more rooms. Its leave-one-place-out mean IoU is .56 on single objects, .49 in an office, .42 at
    other places and .80 in rooms; the best candidates reach .85, .78, .60 and .90."""

    def __post_init__(self) -> None:
        from slgaussian.language.colours import ColourNames
        from slgaussian.language.descriptors import Descriptors

        words = self.vocabulary
        self._descriptors = Descriptors(ColourNames(words.colours), words.groups)
        self._axis = {name: i for i, name in enumerate(self._descriptors.names)}
        # Several methods read the same text in turn.
        self._read = lru_cache(CACHE_SIZE)(words.read)

    @property
    def describing(self) -> tuple[str, ...]:
        """Colours and the nouns for naming."""
        return tuple(sorted([*self.vocabulary.colours, *self.vocabulary.naming]))

    @property
    def advice(self) -> str:
        """Advice to install the classifier; empty if it is installed."""
        if find_weights() is not None:
            return ""
        return f"it knows few nouns: the optional classifier is not installed; {INSTALL}"

    @property
    def width(self) -> int:
        """Number of axes C: the descriptors, then *rest*, then *neutral*."""
        return len(self._axis) + 2

    def encode_regions(
        self, image: np.ndarray, masks: np.ndarray, around: Surroundings | None = None
    ) -> np.ndarray:
        """See :class:`slgaussian.language.Encoder`.

        Without ``around``, descriptors of the room count as undecided.
        """
        vectors = np.zeros((len(masks), self.width))
        if len(masks):
            evidence, axes = self._descriptors.measure(image, masks, around), len(self._axis)
            weighted = np.where(evidence > 0, POSITIVE_WEIGHT * evidence, evidence)
            vectors[:, :axes] = weighted / np.sqrt(axes)
            vectors[:, axes] = np.sqrt(1 - (vectors**2).sum(1))
        return vectors.astype(np.float32)

    @property
    def classifies(self) -> bool:
        """True with a classifier."""
        return self.classifier != "none"

    def class_scores(self, image: np.ndarray, masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`slgaussian.language.Encoder`.

        InputError if the weights are missing or have another SHA-256 than expected.
        """
        from slgaussian.language import classifier

        loaded = classifier.load()
        if loaded is None:
            raise InputError(f"lexicon: its classifier is not installed; {INSTALL}")
        scores = loaded.class_map(image)
        return quantize(classifier.pool(scores, masks)), quantize(scores.mean((0, 1)))

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Encode texts as unit vectors float32 [Q, C].

        Raises:
            InputError: As :meth:`slgaussian.language.vocabulary.Vocabulary.read`, or if no word is
                known.
        """
        vectors = np.zeros((len(texts), self.width))
        for vector, text in zip(vectors, texts, strict=True):
            reading = self._read(text)
            if not reading.words:
                raise unusable(text, reading.unknown)
            for word in reading.words:
                total = sum(abs(weight) for weight in word.weights.values())
                for name, weight in word.weights.items():
                    vector[self._axis[name]] += weight / total
            vector *= WORD_LENGTH
            vector /= max(1.0, float(np.linalg.norm(vector)))
            vector[-1] = np.sqrt(max(0.0, float(1.0 - vector @ vector)))
        return vectors.astype(np.float32)

    def understand(self, text: str, by_class: bool = False) -> Understood:
        """See :meth:`slgaussian.language.Encoder.understand`."""
        reading = self._read(text)
        near = map(self.vocabulary.nearest, reading.unknown[:MAX_LISTED])
        suggestion = " and ".join(repr(word) for word in near if word is not None)
        question = f"; did you mean {suggestion}?" if suggestion else ""
        return Understood(
            read_as=" ".join(word.name for word in reading.words),
            unknown=reading.unknown,
            unused=reading.unused,
            kind="unknown" if reading.unknown else "known",
            measurements=len({name for word in reading.words for name in word.weights}),
            describing=sum(word.family not in NOUN_FAMILIES for word in reading.words),
            classes=reading.classes,
            untold=_refusal(reading, question, by_class),
            question=question,
        )


def _refusal(reading: Reading, question: str, by_class: bool) -> str:
    """Return the reason why a text cannot be answered; empty if it can."""
    if reading.unknown and not reading.noun:
        unknown = ", ".join(map(repr, reading.unknown[:MAX_LISTED]))[:100]
        return f"no word {unknown} is known here{question}; {UNKNOWN_WORD_ADVICE}"
    if reading.classes and not by_class and not any(w.weights for w in reading.words):
        return (
            f"{reading.noun!r} is told by the classifier alone, which this field was built "
            f"without; {INSTALL}, and build it again"
        )
    return ""
