"""The vocabulary of the lexicon, and its parser of texts.

The data are in three files: ``nouns.toml`` has the nouns that appearance describes,
``noun_classes.txt.xz`` the ImageNet classes of nouns, ``vocabulary.toml`` everything else.
``benches/language/noun_table.py`` makes the classes from WordNet 3.0, Copyright 2006 by Princeton
University, all rights reserved; ``noun_classes.LICENSE`` beside them is its licence.
"""

from __future__ import annotations

import difflib
import lzma
import re
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files

from slgaussian.errors import InputError

NOUN_FAMILIES = frozenset(
    {
        "solid", "building", "nature", "street", "vehicle", "animal", "person", "clothing",
        "furniture", "kitchen", "food", "container", "device", "tool", "leisure", "class",
    }
)  # fmt: skip
"""Families whose words name an object; words of the other families describe it. Words of ``class``
are names of ImageNet classes, which appearance alone cannot identify."""

MIN_SIMILARITY = 0.8
"""Smallest similarity (``difflib`` ratio) of a misspelt word to the intended one."""

MAX_CORRECTED_LENGTH = 40
"""Largest number of letters of a word for which a correction is searched."""

TABLE = "noun_classes.txt.xz"
"""One line per set of classes: their numbers, a tab, and its words."""

_WORD = re.compile(r"[^\W_]+(?:'[^\W_]+)*")


@dataclass(frozen=True)
class Word:
    """One word: its family and its weights of descriptors."""

    name: str
    family: str
    weights: Mapping[str, float]


@dataclass(frozen=True)
class Reading:
    """The parse of a text.

    Attributes:
        words: Words that count, in reading order.
        unknown: Spellings that are not in the vocabulary.
        unused: Other ignored spellings, with the reason.
        noun: Spelling of the word that names the object; empty if there is none, or if it may be an
            unknown word.
        classes: ImageNet classes of the noun; see :func:`noun_classes`.
    """

    words: tuple[Word, ...]
    unknown: tuple[str, ...]
    unused: Mapping[str, str]
    noun: str = ""
    classes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Vocabulary:
    """Everything in ``vocabulary.toml`` and ``nouns.toml``.

    Attributes:
        canonical: Phrases that every query competes with.
        colours: {name: (swatches "#rrggbb", smallest factor of linear RGB)}
        groups: {name: {colour: weight}}. Groups of colours.
        words: Words by spelling, synonyms included; neutral words have no weights.
        phrases: Sequences of spellings, stop words included, that form one word.
        naming: Nouns for naming objects without a query.
        unseen: Known words for invisible properties, with the reason.
    """

    canonical: tuple[str, ...]
    colours: Mapping[str, tuple[list[str], float]]
    groups: Mapping[str, Mapping[str, float]]
    words: Mapping[str, Word]
    phrases: Mapping[tuple[str, ...], Word]
    naming: tuple[str, ...]
    unseen: Mapping[str, str]
    stop: frozenset[str]
    relations: frozenset[str]
    negations: frozenset[str]

    @cached_property
    def _max_phrase_length(self) -> int:
        """Number of spellings of the longest phrase."""
        return max(map(len, self.phrases))

    def read(self, text: str) -> Reading:
        """Parse a text as one noun and the words that describe it.

        Case, Unicode normalisation and plurals do not matter; stop words and repetitions are
        dropped. Ignored are unknown words; everything from the first relation word on ("on the
        table" describes another object, while "on the left" is a place and counts); and all nouns
        but one: the last, as a plant pot is a pot, or the last before "of", as a picture of a plant
        is a picture. A few compounds are one word, such as "trash can", a synonym of "bin".

        Raises:
            InputError: If the text is empty, contains a negation, asks for two objects, or has
                neither a word that counts nor an unknown one.
        """
        spelled = spellings(text)
        if not spelled:
            raise InputError(f"query {text!r}: found no word; describe an object, as in 'red ball'")
        for spelling in spelled:
            if spelling in self.negations:
                raise InputError(
                    f"query {excerpt(text)!r}: {spelling!r} cannot be understood, because objects "
                    "are found by what they are, not by what they are not; leave that part out"
                )
        self._check_one_thing(text, spelled)
        spelled, places = self._take_phrases(spelled)
        end = self._phrase_end(spelled)
        content = [s for s in spelled[:end] if s not in self.stop]
        looked_up = [(s, self._look_up(s)) for s in _join_names(content)]
        nouns = [
            i for i, (_, word) in enumerate(looked_up) if word and word.family in NOUN_FAMILIES
        ]
        # The head of "a picture of a plant" is the first noun, that of "a plant pot" the last.
        limit = len(looked_up)
        if "of" in spelled[:end]:
            limit = sum(s not in self.stop for s in spelled[: spelled.index("of")])
        head = max((i for i in nouns if i < limit), default=max(nouns, default=None))
        noun, head_word = ("", None) if head is None else looked_up[head]
        describing = [word for i, (_, word) in enumerate(looked_up) if i == head or i not in nouns]
        words = {word.name: word for word in [*describing, *places] if word}
        elsewhere = [s for s in spelled[end:] if s not in self.stop]
        if not words and all(s in self.unseen for s, _ in looked_up):
            raise unusable(text, [s for s, _ in looked_up] + elsewhere)
        left_out = [(s, word) for s, word in looked_up if word is None or word.name not in words]
        unseen = {s: self.unseen[s] for s, _ in left_out if s in self.unseen}
        unknown = tuple(dict.fromkeys(s for s, word in left_out if not word and s not in unseen))
        other = f"another thing, while {noun!r} is looked for"
        unused = {s: other for s, word in left_out if word and s not in unseen} | unseen
        if elsewhere:
            unused |= dict.fromkeys(elsewhere, f"said of another thing, after {spelled[end]!r}")
        # An unknown word after a noun may be the head, which the noun describes.
        last = [s for s, _ in looked_up[:limit] if s not in unseen][-1:]
        if head_word is None or set(last) & set(unknown):
            return Reading(tuple(words.values()), unknown, unused)
        classes = find_classes(noun) or find_classes(head_word.name)
        return Reading(tuple(words.values()), unknown, unused, noun, classes)

    def _check_one_thing(self, text: str, spelled: Sequence[str]) -> None:
        """Raise InputError if "and" joins two objects."""
        end, idle = self._phrase_end(spelled), self.stop.union(self.unseen)
        for middle in (i for i in range(end) if spelled[i] == "and"):
            sides = spelled[:middle], spelled[middle + 1 : end]
            before, after = ([self._look_up(s) for s in side if s not in idle] for side in sides)
            unknown = after and not any(after)
            if _has_noun(before) and (_has_noun(after) or unknown):
                left, right = (excerpt(" ".join(side)) for side in sides)
                raise InputError(
                    f"query {excerpt(text)!r}: asks for two things; ask for {left!r} and "
                    f"for {right!r} one at a time"
                )

    def explain(self, text: str) -> tuple[bool, str]:
        """Return whether all words of ``text`` are known, and a line on how each is measured."""
        try:
            reading = self.read(text)
        except InputError as refusal:
            return False, f"refused: {refusal}"
        parts = []
        for word in reading.words:
            ways = [f"by its look ({', '.join(word.weights)})"] if word.weights else []
            if reading.noun and word.family in NOUN_FAMILIES and reading.classes:
                count = len(reading.classes)
                ways.append(f"by the classifier ({count} class{'es' * (count > 1)} of ImageNet)")
            parts.append(f"{word.name}, {word.family}: {' and '.join(ways) or 'says nothing'}")
        for spelling in reading.unknown:
            near = self.nearest(spelling)
            parts.append(f"{spelling} is not known{f', did you mean {near!r}?' if near else ''}")
        parts += [f"{word} is set aside: {reason}" for word, reason in reading.unused.items()]
        return not reading.unknown, "; ".join(parts)

    def nearest(self, spelling: str) -> str | None:
        """Return the known word with the most similar spelling, None if there is none."""
        if len(spelling) > MAX_CORRECTED_LENGTH:
            return None
        for spellings in ([*self.words, *self.unseen], noun_classes()):
            if near := difflib.get_close_matches(spelling, spellings, n=1, cutoff=MIN_SIMILARITY):
                return near[0]
        return None

    def _phrase_end(self, spelled: Sequence[str]) -> int:
        """Find the first word that describes another object: "on", or "left" before "of"."""
        for i, spelling in enumerate(spelled):
            if spelling in self.relations:
                return i
            word = self._look_up(spelling)
            place = word is not None and word.family == "place"
            if place and spelled[i + 1 : i + 2] == ["of"] and any(map(self._look_up, spelled[:i])):
                return i
        return len(spelled)

    def families(self) -> dict[str, dict[str, tuple[str, ...]]]:
        """Return all words with weights and their synonyms, by family."""
        families: dict[str, dict[str, tuple[str, ...]]] = {}
        for spelling, word in self.words.items():
            if word.weights:
                family = families.setdefault(word.family, {})
                synonyms = family.get(word.name, ())
                family[word.name] = synonyms + ((spelling,) if spelling != word.name else ())
        return families

    def _take_phrases(self, spelled: list[str]) -> tuple[list[str], list[Word]]:
        """Join noun phrases to one spelling, and take out phrases for places: (spellings, places).

        A phrase after a relation ("on the table on the left") may describe the other object and
        stays, and so does one before "of" ("to the left of the door"), a relation itself.
        """
        left: list[str] = []
        places: list[Word] = []
        start = 0
        while start < len(spelled):
            word, length = self._phrase_at(spelled, start)
            following = spelled[start + length : start + length + 1]
            noun = word is not None and word.family in NOUN_FAMILIES
            if (
                word is None
                or not self.relations.isdisjoint(left)
                or (not noun and following == ["of"])
            ):
                left.append(spelled[start])
                length = 1
            elif noun:
                left.append(word.name)
            else:
                places.append(word)
            start += length
        return left, places

    def _phrase_at(self, spelled: list[str], start: int) -> tuple[Word | None, int]:
        """Find the longest phrase, singular or plural, that begins at ``start``, and its length."""
        for length in range(self._max_phrase_length, 1, -1):
            *first, last = spelled[start : start + length]
            for form in _singulars(last):
                if (*first, form) in self.phrases:
                    return self.phrases[*first, form], length
        return None, 0

    def _look_up(self, spelling: str) -> Word | None:
        for form in _singulars(spelling):
            if form in self.words:
                return self.words[form]
        if not find_classes(spelling):
            return None
        *first, last = spelling.split()
        plainer = self._look_up(last) if first else None
        return plainer or Word(spelling, "class", {})


@cache
def load_vocabulary() -> Vocabulary:
    """Read the package's ``vocabulary.toml`` and ``nouns.toml``."""
    data, nouns = (
        tomllib.loads(files(__package__).joinpath(name).read_text("utf-8"))
        for name in ("vocabulary.toml", "nouns.toml")
    )
    naming = tuple(nouns.pop("naming"))
    synonyms = data["synonyms"] | {
        k: s for family in nouns.values() for k, s in family.pop("also", {}).items()
    }
    words = {name: Word(name, "colour", {name: 1.0}) for name in data["colours"]}
    words |= {name: Word(name, "neutral", {}) for name in data["neutral"]}
    for family, entries in {**data["words"], **nouns}.items():
        words |= {name: Word(name, family, weights) for name, weights in entries.items()}
    for name, spellings in synonyms.items():
        words |= dict.fromkeys(spellings, words[name])
    phrases = {phrase: word for phrase, word in words.items() if " " in phrase}
    phrases |= {p: words[name] for name, several in data["phrases"].items() for p in several}
    return Vocabulary(
        canonical=tuple(data["canonical"]),
        colours={n: (c["swatches"], c["darkest"]) for n, c in data["colours"].items()},
        groups=data["groups"],
        words=words,
        phrases={tuple(phrase.split()): word for phrase, word in phrases.items()},
        naming=naming,
        unseen={s: why for why, several in data["unseen"].items() for s in several},
        stop=frozenset(data["stop"]),
        relations=frozenset(data["relations"]),
        negations=frozenset(data["negations"]),
    )


@cache
def noun_classes() -> Mapping[str, tuple[int, ...]]:
    """Read the table: classes by noun, which has one to three words in lower case."""
    table: dict[str, tuple[int, ...]] = {}
    content = files(__package__).joinpath(TABLE).read_bytes()
    for line in lzma.decompress(content).decode().splitlines():
        numbers, words = line.split("\t")
        table |= dict.fromkeys(words.split(","), tuple(map(int, numbers.split())))
    return table


def spellings(text: str) -> list[str]:
    """Split a text into words in lower case; apostrophes within words are kept."""
    return _WORD.findall(unicodedata.normalize("NFKC", text).replace("’", "'").lower())


def find_classes(noun: str) -> tuple[int, ...]:
    """Return the ImageNet classes of a noun, singular or plural; empty if there are none."""
    *first, last = noun.split()
    forms = (" ".join([*first, form]) for form in _singulars(last))
    return next((noun_classes()[form] for form in forms if form in noun_classes()), ())


def _join_names(spelled: Sequence[str]) -> list[str]:
    """Join consecutive spellings that form the name of a class, as "space shuttle"."""
    joined = list(spelled)
    for length in (3, 2):
        for start in range(len(joined) - length, -1, -1):
            name = " ".join(joined[start : start + length])
            if find_classes(name):
                joined[start : start + length] = [name]
    return joined


def _singulars(word: str) -> list[str]:
    """Return the word and its possible singulars, in the order to try them."""
    forms = [word]
    for ending, singular in (("ies", "y"), ("ves", "f"), ("ves", "fe"), ("s", ""), ("es", "")):
        if word.endswith(ending) and len(word) > len(ending) + 1:
            forms.append(word.removesuffix(ending) + singular)
    return forms


def unusable(text: str, words: Sequence[str]) -> InputError:
    """Make the error for a text without a usable word."""
    idle = excerpt(", ".join(words)) or "they carry no meaning here"
    return InputError(
        f"query {excerpt(text)!r}: none of its words can be used ({idle}); use the lexicon's "
        "words, which `slgaussian words` lists"
    )


def excerpt(text: str) -> str:
    """Return a text for messages, shortened to 60 letters."""
    return text if len(text) <= 60 else text[:57] + "..."


def _has_noun(words: Sequence[Word | None]) -> bool:
    return any(word is not None and word.family in NOUN_FAMILIES for word in words)
