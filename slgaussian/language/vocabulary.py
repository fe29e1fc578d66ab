"""The words that the lexicon knows and how it reads a text; the data are in ``vocabulary.toml``."""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from slgaussian.errors import InputError

NOUNS = frozenset({"solid", "stuff", "furniture", "thing"})
"""Families whose words name an object; words of the other families describe it."""

_WORD = re.compile(r"[^\W_]+(?:'[^\W_]+)*")


@dataclass(frozen=True)
class Word:
    """One word: its family and the weight of each descriptor that it asks for."""

    name: str
    family: str
    weights: Mapping[str, float]


@dataclass(frozen=True)
class Reading:
    """A text as understood: the words that count, and those left out, both in reading order."""

    words: tuple[Word, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class Vocabulary:
    """Everything in ``vocabulary.toml``.

    Attributes
    ----------
    canonical : tuple of str
        Phrases that every query competes with.
    colours : mapping name -> (swatches "#rrggbb", darkest share of light)
    groups : mapping name -> (colour -> weight)
        Kinds of colour.
    words : mapping str -> Word
        By every spelling, synonyms included; neutral words have no weights.
    stop, relations, negations : frozenset of str
    """

    canonical: tuple[str, ...]
    colours: Mapping[str, tuple[list[str], float]]
    groups: Mapping[str, Mapping[str, float]]
    words: Mapping[str, Word]
    stop: frozenset[str]
    relations: frozenset[str]
    negations: frozenset[str]

    def read(self, text: str) -> Reading:
        """Understand a text as one noun and what describes it.

        Case, accents' encoding and plurals do not matter, stop words are dropped, a repeated word
        counts once. Left out are unknown words, everything from the first relation word on ("on
        the table" describes another object), and nouns before the last noun (a plant pot is a pot).

        Raises
        ------
        InputError
            If the text is empty, holds a negation, or has no word that counts.
        """
        spelled = _WORD.findall(unicodedata.normalize("NFKC", text).replace("’", "'").lower())
        if not spelled:
            raise InputError(f"query {text!r}: found no word; describe an object, as in 'red ball'")
        for spelling in spelled:
            if spelling in self.negations:
                raise InputError(
                    f"query {_short(text)!r}: {spelling!r} cannot be understood, because objects "
                    "are found by what they are, not by what they are not; leave that part out"
                )
        end = next((i for i, s in enumerate(spelled) if s in self.relations), len(spelled))
        known = [(s, self._look_up(s)) for s in spelled[:end] if s not in self.stop]
        nouns = [i for i, (_, word) in enumerate(known) if word and word.family in NOUNS]
        counts = [w is not None and i not in nouns[:-1] for i, (_, w) in enumerate(known)]
        words = {
            word.name: word for (_, word), counted in zip(known, counts, strict=True) if counted
        }
        left_out = [s for (s, _), counted in zip(known, counts, strict=True) if not counted]
        left_out += [s for s in spelled[end:] if s not in self.stop]
        if not words:
            unused = _short(", ".join(left_out)) or "they carry no meaning here"
            raise InputError(
                f"query {_short(text)!r}: none of its words can be used ({unused}); use the "
                "lexicon's words, which `slgaussian words` lists"
            )
        return Reading(tuple(words.values()), tuple(dict.fromkeys(left_out)))

    def families(self) -> dict[str, dict[str, tuple[str, ...]]]:
        """Every word that counts by family, with its synonyms."""
        found: dict[str, dict[str, tuple[str, ...]]] = {}
        for spelling, word in self.words.items():
            if word.weights:
                family = found.setdefault(word.family, {})
                synonyms = family.get(word.name, ())
                family[word.name] = synonyms + ((spelling,) if spelling != word.name else ())
        return found

    def _look_up(self, spelling: str) -> Word | None:
        for form in _singulars(spelling):
            if form in self.words:
                return self.words[form]
        return None


@cache
def load_vocabulary() -> Vocabulary:
    """Read ``vocabulary.toml``, which is part of the package."""
    data = tomllib.loads(files(__package__).joinpath("vocabulary.toml").read_text("utf-8"))
    words = {name: Word(name, "colour", {name: 1.0}) for name in data["colours"]}
    words |= {name: Word(name, "neutral", {}) for name in data["neutral"]}
    for family, entries in data["words"].items():
        words |= {name: Word(name, family, weights) for name, weights in entries.items()}
    for name, others in data["synonyms"].items():
        words |= dict.fromkeys(others, words[name])
    return Vocabulary(
        canonical=tuple(data["canonical"]),
        colours={n: (c["swatches"], c["darkest"]) for n, c in data["colours"].items()},
        groups=data["groups"],
        words=words,
        stop=frozenset(data["stop"]),
        relations=frozenset(data["relations"]),
        negations=frozenset(data["negations"]),
    )


def _singulars(word: str) -> list[str]:
    """The word and what it may be the plural of, in the order to try them."""
    forms = [word]
    for ending, singular in (("ies", "y"), ("ves", "f"), ("es", ""), ("s", "")):
        if word.endswith(ending) and len(word) > len(ending) + 1:
            forms.append(word.removesuffix(ending) + singular)
    return forms


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
