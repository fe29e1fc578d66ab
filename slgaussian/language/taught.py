"""Words that a user teaches by example: "this is the fox".

An encoder may not know the user's word for an object. A taught word has examples, the features of
objects that the user pointed at, and rivals, the features of the other objects of that scene. The
score of an object is its similarity to the most similar example.

Features of regions are close to each other, so plain cosines discriminate badly: two objects of one
photograph easily have 0.95. Their common part is therefore subtracted: with m the mean of the
word's rivals, and u(x) = (x - m) / |x - m|,

    likeness(L, e) = u(L) . u(e)
    lead(L) = SCALE ( max_e likeness(L, e) - EVEN )

over the examples e. The lead is 0 at the decision boundary. It replaces a text's lead over the
canonical phrases in :mod:`slgaussian.language.relevancy`, so temperature, threshold, views and
groups work as for other words.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.io import short_repr
from slgaussian.language.relevancy import UNIT_TOLERANCE
from slgaussian.storage.encoding import decode_arrays, encode_artifact
from slgaussian.storage.specs import load_spec

SPEC = "words"

EVEN = 0.45
"""Likeness at the decision boundary. At .6 the IoU in other image pairs of the same place falls
from .46 to .40; at .3 84 % of the words match something where their object is absent, at .45 49 %
(``docs/measured/words.md``)."""

SCALE = 0.2
"""Factor from likeness to cosine: an example itself then has relevancy 0.75 at temperature 10.
Answers are about as good from 0.1 to 0.6."""

LONGEST = 80
"""Largest number of letters of a word."""

REPAIR = "remove the file, and teach the words again"


def _texts() -> np.ndarray:
    return np.zeros(0, "<U1")


def _vectors() -> np.ndarray:
    return np.zeros((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class TaughtWords:
    """Immutable set of taught words; empty by default, as in a new field.

    Attributes:
        encoder: :func:`encoder_identity` of the features' encoder; empty without words.
        words: str [E]. Word of each example, normalised by :func:`normal`.
        features: float32 [E, C]. Unit vectors of the encoder, rounded to half precision.
        rival_words: str [R]. Word of each rival.
        rivals: float32 [R, C]. Features of the other objects of the scene where the word was
            taught.

    Raises:
        InputError: If shapes do not match, or a feature is not a unit vector.
    """

    encoder: str = ""
    words: np.ndarray = field(default_factory=_texts)
    features: np.ndarray = field(default_factory=_vectors)
    rival_words: np.ndarray = field(default_factory=_texts)
    rivals: np.ndarray = field(default_factory=_vectors)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        examples, rivals = len(self.words), len(self.rival_words)
        width = self.features.shape[-1] if self.features.ndim == 2 else 0
        expected = {"features": (examples, width), "rivals": (rivals, width)}
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"taught words {name}: found {getattr(self, name).shape}, expected {shape}"
                )
        for name in ("features", "rivals"):
            lengths = np.linalg.norm(getattr(self, name).astype(np.float64), axis=1)
            if not (np.abs(lengths - 1) <= UNIT_TOLERANCE).all():
                raise InputError(f"taught words {name}: hold a vector that is no unit vector")

    def __iter__(self) -> Iterator[str]:
        """Iterate over the words in alphabetical order."""
        return iter(self._known)

    def __len__(self) -> int:
        """Count the words."""
        return len(self._known)

    @cached_property
    def _known(self) -> list[str]:
        return np.unique(self.words).tolist()

    def __contains__(self, text: object) -> bool:
        """Return whether a text is a taught word, ignoring case and extra spaces."""
        return isinstance(text, str) and spelled(text) in self._known

    def examples(self, word: str) -> int:
        """Count the examples of a word."""
        return int((self.words == normal(word)).sum())

    def with_example(
        self,
        word: str,
        feature: np.ndarray,
        rivals: np.ndarray,
        encoder: str,
    ) -> TaughtWords:
        """Return the words with one more example, without duplicates.

        A rival that equals an example of the word is removed.

        Args:
            feature: float [C]. Unit vector of the object.
            rivals: float [R, C]. Unit vectors of the other objects of the scene.
            encoder: From :func:`encoder_identity`.

        Raises:
            InputError: If the word is empty or too long, or the existing words have another
                encoder.
        """
        word = normal(word)
        self.check_encoder(encoder)
        vector, new_rivals = _half(feature[None]), _half(rivals)
        width = vector.shape[1]
        if len(self.words) and self.features.shape[1] != width:
            raise InputError(
                f"taught words: features are {self.features.shape[1]} wide, found one of {width}; "
                "forget them and teach them again"
            )
        features, old = self.features.reshape(-1, width), self.rivals.reshape(-1, width)
        keep = (self.words != word) | (features != vector).any(1)
        words = np.append(self.words[keep], word)
        features = np.concatenate([features[keep], vector])
        rival_words = np.append(self.rival_words, np.full(len(new_rivals), word))
        rivals = np.concatenate([old, new_rivals])
        present = {example.tobytes() for example in features[words == word]}
        stay = rival_words != word
        for row in np.flatnonzero(~stay):
            stay[row] = rivals[row].tobytes() not in present
            present.add(rivals[row].tobytes())
        return TaughtWords(encoder, words, features, rival_words[stay], rivals[stay])

    def without(self, word: str) -> TaughtWords:
        """Return the words without ``word`` and its examples; InputError if it is not taught."""
        word = normal(word)
        if not (self.words == word).any():
            taught_words = ", ".join(map(repr, self)) or "none"
            raise InputError(f"{word!r}: is no taught word; those there are: {taught_words}")
        keep, stay = self.words != word, self.rival_words != word
        if not keep.any():
            return TaughtWords()
        return replace(
            self,
            words=self.words[keep],
            features=self.features[keep],
            rival_words=self.rival_words[stay],
            rivals=self.rivals[stay],
        )

    def leads(self, word: str, looks: np.ndarray) -> np.ndarray:
        """Compute the module's lead, float64 [P], of regions with unit vectors ``looks`` [P, C].

        InputError if the word is not taught, or the vectors have another dimension.
        """
        word = normal(word)
        examples = self.words == word
        if not examples.any():
            raise InputError(f"{word!r}: has no example; teach it first")
        if looks.ndim != 2 or looks.shape[1] != self.features.shape[1]:
            raise InputError(
                f"taught words: features are {self.features.shape[1]} wide, found looks "
                f"{looks.shape}; they must come from the same encoder"
            )
        rivals = self.rivals[self.rival_words == word].astype(np.float64)
        common = rivals.mean(0) if len(rivals) else np.zeros(looks.shape[1])
        directions = _directions(looks, common)
        likeness = np.einsum("pc,ec->pe", directions, _directions(self.features[examples], common))
        return SCALE * (likeness.max(1) - EVEN)

    def check_encoder(self, encoder: str) -> None:
        """Raise InputError if these words have another encoder."""
        if self.encoder and encoder != self.encoder:
            raise InputError(
                f"taught words: are of the encoder {_brief(self.encoder)}, but this field's is "
                f"{_brief(encoder)}"
            )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name, as stored: features in half precision."""
        return {
            "encoder": np.array(self.encoder),
            "words": self.words.astype(np.str_),
            "features": self.features.astype(np.float16),
            "rival_words": self.rival_words.astype(np.str_),
            "rivals": self.rivals.astype(np.float16),
        }

    def to_bytes(self) -> bytes:
        """Encode the words as the bytes of a file, deterministically."""
        return encode_artifact(SPEC, self.to_arrays(), "taught words")[1]

    @staticmethod
    def from_bytes(data: bytes, file: str, encoder: str) -> TaughtWords:
        """Decode :meth:`to_bytes`; ``file`` is the name for messages.

        Raises:
            SpecError: If the file is damaged, or its words are not of ``encoder``
                (:func:`encoder_identity`).
        """
        arrays = decode_arrays(data, load_spec(SPEC), file, repair=REPAIR)
        try:
            words = TaughtWords(
                str(arrays["encoder"]),
                arrays["words"],
                arrays["features"].astype(np.float32),
                arrays["rival_words"],
                arrays["rivals"].astype(np.float32),
            )
            words.check_encoder(encoder)
        except InputError as error:
            raise SpecError(f"{file}: {error}; {REPAIR}") from error
        return words


def normal(word: str) -> str:
    """Normalise a word for teaching and queries: lower case, single spaces.

    InputError if it is empty, or has more than :data:`LONGEST` letters.
    """
    plain = spelled(word)
    if not plain or len(plain) > LONGEST:
        problem = f"{len(plain)} letters" if plain else "an empty text"
        raise InputError(f"word: found {problem}, expected 1 to {LONGEST} letters")
    return plain


def spelled(word: str) -> str:
    """Normalise case and spaces; words and names are compared in this form."""
    return " ".join(word.casefold().split())


def encoder_identity(settings: Mapping[str, Any]) -> str:
    """Return the identity of the encoder of a field's features, as JSON.

    Files are identified by content, so that words can be used on other machines. Unset fields are
    omitted, and so is the lexicon's classifier, which does not affect features.
    """
    name = settings["encoder"]
    identity = {"encoder": name, **dict(settings.get(name, {}))}
    identity.pop("classifier", None)
    return json.dumps({k: v for k, v in identity.items() if v is not None}, sort_keys=True)


def _brief(encoder: str) -> str:
    """Shorten an encoder identity for messages."""
    try:
        identity = strict_json.parse(encoder)
        name = identity.pop("encoder")
    except (ValueError, KeyError, AttributeError):
        return repr(encoder[:40])
    details = ", ".join(f"{key} {str(value)[:12]}" for key, value in identity.items() if value)
    return f"{name!r}" + (f" ({details})" if details else "")


def _half(vectors: np.ndarray) -> np.ndarray:
    """Round vectors to half precision, so that saved words give the same answers."""
    return vectors.astype(np.float16).astype(np.float32)


def _directions(vectors: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Compute unit vectors float64 from ``common`` [C] to ``vectors`` [K, C]; zero if equal."""
    away = vectors.astype(np.float64) - common
    lengths = np.linalg.norm(away, axis=1, keepdims=True)
    return away / np.where(lengths > 0, lengths, 1)
