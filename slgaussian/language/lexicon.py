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
and how each is measured are listed in docs/reference/lexicon.md. Nouns that a look does not tell,
an ImageNet classifier does (:mod:`slgaussian.language.classifier`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language.class_evidence import quantised
from slgaussian.language.confidence import Calibration, Curve
from slgaussian.language.vocabulary import NOUNS, load_vocabulary, unusable
from slgaussian.language.weights import INSTALL
from slgaussian.language.wholes import Ranking

if TYPE_CHECKING:
    from slgaussian.geometry.room import Surroundings

OTHERS = "teach it by examples, or build the field with --encoder clip, which knows any word"
"""What to do about a word that nothing tells."""

MENTIONED = 3
"""Unknown words of a text that are mentioned."""

REMEMBERED = 4096
"""Texts whose reading is kept."""

POSITIVE = 0.8
"""Evidence for a descriptor counts this much of evidence against: one word that does not fit
outweighs one that does, so a red box is not, on balance, a red ball."""

SAYS = 0.5
"""Length, in a text's unit vector, of a word that asks for one descriptor: four such words fill it.
The order of objects for one text does not depend on it."""


@dataclass(eq=False)
class Lexicon:
    """Regions and texts by the words of an explicit vocabulary, without weights; see the module.

    Attributes
    ----------
    classifier : str
        ``lite0`` if regions are also named by :mod:`slgaussian.language.classifier`; its weights
        are needed for regions, not for texts. Else ``none``.
    """

    classifier: str = "none"
    name: ClassVar[str] = "lexicon"
    calibration: ClassVar[Calibration] = Calibration(
        mask=Curve(1.96, 1.886, -0.288, 0.364, -4.691),
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
    """Of a softmax over the candidates of a text, fitted to their IoU with what is labelled at 12
    places and in 8 made-up rooms. ``python -m benches.language.fit_ranking DATA`` fits it anew, to
    more rooms, and has with each place left out a mean IoU of .56 on single things, .49 in an
    office, .42 at other places and .80 in rooms; the best candidates have .85, .78, .60 and .90."""

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

    def class_scores(
        self, image: np.ndarray, masks: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Classify regions bool [M, H, W] and the whole uint8 photograph.

        uint8 [M, 1000] and [1000], as :func:`~slgaussian.language.class_evidence.quantised`
        has them; None without a classifier. InputError if its weights are missing or not those
        known.
        """
        if self.classifier == "none":
            return None
        from slgaussian.language import classifier

        loaded = classifier.load()
        if loaded is None:
            raise InputError(f"lexicon: its classifier is not installed; {INSTALL}")
        scores = loaded.class_map(image)
        pooled = classifier.pool(scores, masks)
        return quantised(pooled), quantised(scores.mean((0, 1)))

    def classes(self, text: str) -> tuple[int, ...]:
        """The classes that the noun of ``text`` means; InputError as in :meth:`encode_text`."""
        return self._read(text).classes

    def describing(self, text: str) -> int:
        """Count the words that describe the noun of ``text``; InputError as :meth:`encode_text`."""
        return sum(word.family not in NOUNS for word in self._read(text).words)

    def encode_text(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C] of texts.

        Raises
        ------
        InputError
            As :meth:`slgaussian.language.vocabulary.Vocabulary.read`, or if no word is known.
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
            vector *= SAYS
            vector /= max(1.0, float(np.linalg.norm(vector)))
            vector[-1] = np.sqrt(max(0.0, float(1.0 - vector @ vector)))
        return vectors.astype(np.float32)

    def untold(self, text: str, by_class: bool) -> str:
        """The reason why ``text`` cannot be answered; empty if it can.

        ``by_class``: whether a classifier has seen the regions. InputError as in
        :meth:`encode_text`.
        """
        reading = self._read(text)
        if reading.unknown and not reading.noun:
            unknown = ", ".join(map(repr, reading.unknown[:MENTIONED]))[:100]
            return f"no word {unknown} is known here{self.question(text)}; {OTHERS}"
        if reading.classes and not by_class and not any(w.weights for w in reading.words):
            return (
                f"{reading.noun!r} is told by the classifier alone, which this field was built "
                f"without; {INSTALL}, and build it again"
            )
        return ""

    def question(self, text: str) -> str:
        """Ask for the known words that are spelled as unknown ones of ``text`` nearly are."""
        near = map(self._vocabulary.nearest, self._read(text).unknown[:MENTIONED])
        words = " and ".join(repr(word) for word in near if word is not None)
        return f"; did you mean {words}?" if words else ""

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
        """Count the descriptors that the words of ``text`` ask for."""
        words = self._read(text).words
        return len({name for word in words for name in word.weights})
