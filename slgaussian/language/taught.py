"""Words that a user teaches: "this is the fox".

An encoder may not know what a user calls a thing. A taught word has examples, the features of
objects that the user pointed at; and rivals, the other objects of the scene where it was taught. An
object fits as well as it is like the best example.

Features of regions all lie near each other, far from those of texts, so their plain cosines say
little: two things of one photograph easily have 0.95. What all regions have in common is therefore
taken out first: with m the mean of the word's rivals, and u(x) = (x - m) / |x - m|,

    likeness(L, e) = u(L) . u(e)
    lead(L) = SCALE ( max_e likeness(L, e) - EVEN )

over the examples e. It is 0 where a thing is as like the examples as not, and takes the place of a
text's lead over the canonical phrases in :mod:`slgaussian.language.relevancy`, so that temperature,
threshold, views and groups mean what they mean for other words.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.io import short_repr, write_atomic
from slgaussian.language.relevancy import UNIT_TOLERANCE
from slgaussian.storage.encoding import decode_arrays, encode_artifact
from slgaussian.storage.specs import load_spec

SPEC = "words"

EVEN = 0.45
"""Likeness to an example up to which a thing is taken for another one. At .6 IoU in other pairs of
the same place falls from .46 to .40; at .3 84 % of the words find something where their thing is
not, and at .45 49 % (``docs/measured/words.md``)."""

SCALE = 0.2
"""How much a lead in likeness counts as a lead in cosine of a text: an example itself then has the
relevancy 0.75 at temperature 10. From 0.1 to 0.6 the answers are about as good."""

LONGEST = 80
"""Letters of a word."""

REPAIR = "teach the words again, or use another copy of the file"


def _texts() -> np.ndarray:
    return np.zeros(0, "<U1")


def _vectors() -> np.ndarray:
    return np.zeros((0, 0), np.float32)


@dataclass(frozen=True, eq=False)
class TaughtWords:
    """Words by example; without any, what a new field has. Every change makes another one.

    Attributes
    ----------
    encoder : str
        Which encoder made the features, as :func:`encoder_identity` says it; empty without words.
    words : str [E]
        The word of each example, as :func:`normal` writes it.
    features : float32 [E, C]
        Unit vectors in the encoder's space, of half precision.
    rival_words : str [R]
        The word that each rival competes with.
    rivals : float32 [R, C]
        Features of the other objects where the word was taught.

    Raises
    ------
    InputError
        If the arrays do not belong together, or a feature is no unit vector.
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
        """Iterate over the words in order of the alphabet."""
        return iter(self._known)

    def __len__(self) -> int:
        """Count the words."""
        return len(self._known)

    @cached_property
    def _known(self) -> list[str]:
        return np.unique(self.words).tolist()

    def __contains__(self, text: object) -> bool:
        """Return whether a text is a taught word, whatever its case and spaces."""
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
        """The words with one example more, of which each is there once.

        A thing that is an example is no rival of that word any longer.

        Parameters
        ----------
        word : str
        feature : float [C]
            Unit vector of the thing.
        rivals : float [R, C]
            Unit vectors of the other things there.
        encoder : str
            Of :func:`encoder_identity`.

        Raises
        ------
        InputError
            If the word is empty or too long, or the other words are of another encoder.
        """
        word = normal(word)
        self.check_encoder(encoder, "the taught words")
        vector, others = _half(feature[None]), _half(rivals)
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
        rival_words = np.append(self.rival_words, np.full(len(others), word))
        rivals = np.concatenate([old, others])
        taken = {one.tobytes() for one in features[words == word]}
        stay = rival_words != word
        for row in np.flatnonzero(~stay):
            stay[row] = rivals[row].tobytes() not in taken
            taken.add(rivals[row].tobytes())
        return TaughtWords(encoder, words, features, rival_words[stay], rivals[stay])

    def without(self, word: str) -> TaughtWords:
        """The words but this one, with all its examples; InputError if it is not there."""
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

    def merged(self, other: TaughtWords) -> TaughtWords:
        """These words and those of ``other``; a word of both has the examples of both.

        Raises
        ------
        InputError
            If they are of different encoders.
        """
        if not len(other.words):
            return self
        if not len(self.words):
            return other
        self.check_encoder(other.encoder, "the taught words")
        arrays = {
            f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)])
            for f in fields(self)
            if f.name != "encoder"
        }
        return TaughtWords(self.encoder, **arrays)

    def leads(self, word: str, looks: np.ndarray) -> np.ndarray:
        """The lead of the module, float64 [P], of looks float [P, C]: unit vectors of regions.

        InputError if the word is not taught, or the looks are of another width.
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

    def check_encoder(self, encoder: str, what: str) -> None:
        """InputError, naming ``what``, if these words are of another encoder than that one."""
        if self.encoder and encoder != self.encoder:
            raise InputError(
                f"{what}: are of the encoder {_brief(self.encoder)}, but this field's is "
                f"{_brief(encoder)}; teach them in a field of this one"
            )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The arrays by name, as stored: features in half precision."""
        return {
            "encoder": np.array(self.encoder),
            "words": self.words.astype(np.str_),
            "features": self.features.astype(np.float16),
            "rival_words": self.rival_words.astype(np.str_),
            "rivals": self.rivals.astype(np.float16),
        }

    def encode_artifact(self) -> bytes:
        """The bytes of the file of these words; the same of the same."""
        return encode_artifact(SPEC, self.to_arrays(), "taught words")[1]

    def save(self, path: str | Path) -> None:
        """Write the words to a file, ``.npz``, that other fields of the encoder can take.

        InputError if it cannot be written.
        """
        try:
            write_atomic(path, self.packed())
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from error

    @staticmethod
    def load(path: str | Path, encoder: str | None = None) -> TaughtWords:
        """Read the words of a file.

        Parameters
        ----------
        path : path or str
            Of :meth:`save`, such as ``words.npz`` of a field folder.
        encoder : str, optional
            Of :func:`encoder_identity`: which encoder they must be of.

        Raises
        ------
        InputError
            If there is no such file, or its words are of another encoder.
        SpecError
            If it is damaged.
        """
        try:
            data = Path(path).read_bytes()
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error.strerror}); give a file of taught words, such as "
                f"words.npz of a field folder"
            ) from error
        arrays = decode_arrays(data, load_spec(SPEC), os.fspath(path), repair=REPAIR)
        # Counter-examples, which files of version 1 may have, count no more.
        yes = arrays.get("positive", np.ones(len(arrays["words"]), bool))
        try:
            words = TaughtWords(
                _without_nulls(str(arrays["encoder"])),
                arrays["words"][yes],
                arrays["features"][yes].astype(np.float32),
                arrays["rival_words"],
                arrays["rivals"].astype(np.float32),
            )
        except InputError as error:
            raise SpecError(f"{path}: {error}; {REPAIR}") from error
        if encoder is not None:
            words.check_encoder(encoder, os.fspath(path))
        return words


def normal(word: str) -> str:
    """A word as it is taught and asked: lower case, single spaces.

    InputError if nothing is left of it, or it has more than :data:`LONGEST` letters.
    """
    plain = spelled(word)
    if not plain or len(plain) > LONGEST:
        problem = f"{len(plain)} letters" if plain else "an empty text"
        raise InputError(f"word: found {problem}, expected 1 to {LONGEST} letters")
    return plain


def spelled(word: str) -> str:
    """A text whatever its case and spaces: words and names that agree in this are the same."""
    return " ".join(word.casefold().split())


def encoder_identity(settings: Mapping[str, Any]) -> str:
    """Return the identity of the encoder that made a field's features, as JSON.

    Files are there by content, so that words pass between machines. What is not set is left out,
    and so is the lexicon's classifier, which changes no feature.
    """
    name = settings["encoder"]
    identity = {"encoder": name, **dict(settings.get(name, {}))}
    identity.pop("classifier", None)
    return json.dumps({k: v for k, v in identity.items() if v is not None}, sort_keys=True)


def _without_nulls(encoder: str) -> str:
    """The identity of a file as :func:`encoder_identity` writes it today."""
    try:
        identity = json.loads(encoder)
        return encoder_identity({"encoder": identity["encoder"], identity.pop("encoder"): identity})
    except (ValueError, LookupError, TypeError, AttributeError):
        return encoder


def _brief(encoder: str) -> str:
    """An identity as a message says it."""
    try:
        identity = strict_json.parse(encoder)
        name = identity.pop("encoder")
    except (ValueError, KeyError, AttributeError):
        return repr(encoder[:40])
    details = ", ".join(f"{key} {str(value)[:12]}" for key, value in identity.items() if value)
    return f"{name!r}" + (f" ({details})" if details else "")


def _half(vectors: np.ndarray) -> np.ndarray:
    """Vectors rounded to half precision, as they are stored: what was saved answers the same."""
    return vectors.astype(np.float16).astype(np.float32)


def _directions(vectors: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Unit vectors float64 of ``vectors`` [K, C] seen from ``common`` [C]; zero where they meet."""
    away = vectors.astype(np.float64) - common
    lengths = np.linalg.norm(away, axis=1, keepdims=True)
    return away / np.where(lengths > 0, lengths, 1)
