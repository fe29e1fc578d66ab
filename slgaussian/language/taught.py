"""Words that a user teaches by example: "this is the fox".

An encoder may not know the user's word for an object. A taught word has examples, the features of
objects that the user pointed at, and rivals, the features of the other objects of that scene. The
score of an object is its similarity to the most similar example.

Features of regions are close to each other: the cosine of two objects of one photograph easily is
0.95. Their common part is therefore subtracted: with m the mean of the word's rivals, and u(x) =
(x - m) / |x - m|,

    likeness(L, e) = u(L) . u(e)
    lead(L) = COSINE_SCALE ( max_e likeness(L, e) - BOUNDARY_LIKENESS )

over the examples e. The lead is 0 at the decision boundary. It replaces a text's lead over the
canonical phrases in :mod:`slgaussian.language.scoring`, so temperature, threshold, views and
groups work as for other words.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.language.bank import UNIT_TOLERANCE

BOUNDARY_LIKENESS = 0.45
"""Likeness at the decision boundary. At .6 the IoU in other image pairs of the same place falls
from .46 to .40; at .3 84 % of the words match something where their object is absent, at .45 49 %
(``docs/measured/earlier.md``)."""

COSINE_SCALE = 0.2
"""Factor from likeness to cosine: an example itself then has relevancy 0.75 at temperature 10.
Answers are about as good from 0.1 to 0.6."""

MAX_WORD_LENGTH = 80
"""Largest number of letters of a word."""


class Lesson(NamedTuple):
    """Features of one word: unit vectors of the encoder, rounded to half precision.

    Attributes:
        examples: float32 [E, C]. Objects that the word means.
        rivals: float32 [R, C]. Other objects of the scenes where it was taught, none an example.
    """

    examples: np.ndarray
    rivals: np.ndarray


@dataclass(frozen=True, eq=False)
class TaughtWords:
    """Immutable set of taught words; empty by default, as in a new field.

    Attributes:
        encoder: :func:`encoder_identity` of the features' encoder; empty without words.
        lessons: {word: its features}. Words are normalised by :func:`normalize`.
    """

    encoder: str = ""
    lessons: Mapping[str, Lesson] = field(default_factory=dict)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the words in alphabetical order."""
        return iter(sorted(self.lessons))

    def __len__(self) -> int:
        """Count the words."""
        return len(self.lessons)

    def __contains__(self, text: object) -> bool:
        """Return whether a text is a taught word, ignoring case and extra spaces."""
        return isinstance(text, str) and unify_spelling(text) in self.lessons

    def examples(self, word: str) -> int:
        """Count the examples of a word."""
        return len(self.lessons[normalize(word)].examples)

    def add_example(
        self, word: str, feature: np.ndarray, rivals: np.ndarray, encoder: str
    ) -> TaughtWords:
        """Return the words with one more example, without duplicates.

        Args:
            feature: float [C]. Unit vector of the object.
            rivals: float [R, C]. Unit vectors of the other objects of the scene.
            encoder: From :func:`encoder_identity`.

        Raises:
            InputError: If the word is empty or too long, or the words have another encoder.
        """
        word = normalize(word)
        self.check_encoder(encoder)
        # Rounded to half precision, so that saved words give the same answers.
        examples, others = (
            x.astype(np.float16).astype(np.float32) for x in (feature[None], rivals)
        )
        if word in self.lessons:
            examples = np.concatenate([self.lessons[word].examples, examples])
            others = np.concatenate([self.lessons[word].rivals, others])
        distinct = {example.tobytes(): example for example in examples}
        opposed = {other.tobytes(): other for other in others if other.tobytes() not in distinct}
        lesson = Lesson(
            *(np.array([*x.values()]).reshape(-1, len(feature)) for x in (distinct, opposed))
        )
        return TaughtWords(encoder, {**self.lessons, word: lesson})

    def remove(self, word: str) -> TaughtWords:
        """Return the words without ``word`` and its examples; InputError if it is not taught."""
        word = normalize(word)
        if word not in self.lessons:
            words = ", ".join(map(repr, self)) or "none"
            raise InputError(f"{word!r}: is no taught word; those there are: {words}")
        left = {name: lesson for name, lesson in self.lessons.items() if name != word}
        return replace(self, lessons=left) if left else TaughtWords()

    def leads(self, word: str, looks: np.ndarray) -> np.ndarray:
        """Compute the module's lead, float64 [P], of unit vectors [P, C] to a taught word."""
        examples, rivals = self.lessons[normalize(word)]
        common = rivals.astype(np.float64).mean(0) if len(rivals) else np.zeros(looks.shape[1])
        likeness = np.einsum("pc,ec->pe", *(_directions(x, common) for x in (looks, examples)))
        return COSINE_SCALE * (likeness.max(1) - BOUNDARY_LIKENESS)

    def check_encoder(self, encoder: str) -> None:
        """Raise InputError if these words have another encoder."""
        if self.encoder and encoder != self.encoder:
            raise InputError(
                f"taught words: are of the encoder {self.encoder:.80}, but this field's is "
                f"{encoder:.80}"
            )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name, as stored: features in half precision."""
        lessons = [(word, self.lessons[word]) for word in self]
        width = lessons[0][1].examples.shape[1] if lessons else 0
        arrays = {"encoder": np.array(self.encoder)}
        for part, names, features in ((0, "words", "features"), (1, "rival_words", "rivals")):
            words = [word for word, lesson in lessons for _ in lesson[part]]
            vectors = [np.zeros((0, width)), *(lesson[part] for _, lesson in lessons)]
            arrays[names] = np.array(words, np.str_)
            arrays[features] = np.concatenate(vectors).astype("f2")
        return arrays

    @staticmethod
    def from_arrays(arrays: Mapping[str, np.ndarray], encoder: str) -> TaughtWords:
        """Inverse of :meth:`to_arrays`.

        Raises:
            SpecError: If a feature is no unit vector, or the words are of another encoder.
        """
        for name in ("features", "rivals"):
            lengths = np.linalg.norm(arrays[name].astype(np.float64), axis=1)
            if not (np.abs(lengths - 1) <= UNIT_TOLERANCE).all():
                raise SpecError(f"{name} hold a vector that is no unit vector")
        features, rivals = (arrays[name].astype(np.float32) for name in ("features", "rivals"))
        lessons = {
            str(word): Lesson(
                features[arrays["words"] == word], rivals[arrays["rival_words"] == word]
            )
            for word in np.unique(arrays["words"])
        }
        words = TaughtWords(str(arrays["encoder"]), lessons)
        words.check_encoder(encoder)
        return words


def normalize(word: str) -> str:
    """Normalise a word for teaching and queries: lower case, single spaces.

    InputError if it is empty, or has more than :data:`MAX_WORD_LENGTH` letters.
    """
    plain = unify_spelling(word)
    if not plain or len(plain) > MAX_WORD_LENGTH:
        problem = f"{len(plain)} letters" if plain else "an empty text"
        raise InputError(f"word: found {problem}, expected 1 to {MAX_WORD_LENGTH} letters")
    return plain


def unify_spelling(word: str) -> str:
    """Normalise case and spaces; words and names are compared in this form."""
    return " ".join(word.casefold().split())


def encoder_identity(settings: Mapping[str, Any]) -> str:
    """Return the identity of the encoder of a field's features, as JSON.

    Unset fields are omitted, and so is the lexicon's classifier, which does not affect features.
    """
    name = settings["encoder"]
    identity = {"encoder": name, **dict(settings.get(name, {}))}
    identity.pop("classifier", None)
    return json.dumps({k: v for k, v in identity.items() if v is not None}, sort_keys=True)


def _directions(vectors: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Compute unit vectors float64 from ``common`` [C] to ``vectors`` [K, C]; zero if equal."""
    centred = vectors.astype(np.float64) - common
    lengths = np.linalg.norm(centred, axis=1, keepdims=True)
    return centred / np.where(lengths > 0, lengths, 1)
