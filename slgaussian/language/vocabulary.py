"""The words that the lexicon knows, and how it reads a text.

The data are in two files: ``nouns.toml`` has the nouns, ``vocabulary.toml`` all else.
"""

from __future__ import annotations

import difflib
import re
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files

from slgaussian.errors import InputError
from slgaussian.language.nouns import noun_classes

NOUNS = frozenset(
    {
        "solid", "building", "nature", "street", "vehicle", "animal", "person", "clothing",
        "furniture", "kitchen", "food", "container", "device", "tool", "leisure", "class",
    }
)  # fmt: skip
"""Families whose words name an object; words of the other families describe it. Those of ``class``
are names of classes of ImageNet, which look alone does not tell."""

NEAR = 0.8
"""Share of letters in order that a misspelt word has in common with the one that is meant."""

LONGEST = 40
"""Letters of a word that may be a misspelt one."""

_WORD = re.compile(r"[^\W_]+(?:'[^\W_]+)*")


@dataclass(frozen=True)
class Word:
    """One word: its family and the weight of each descriptor that it asks for."""

    name: str
    family: str
    weights: Mapping[str, float]


@dataclass(frozen=True)
class Reading:
    """A text as understood.

    Attributes
    ----------
    words : tuple of Word
        Those that count, in reading order.
    unknown : tuple of str
        Spellings that are no word of the vocabulary.
    unused : {spelling: why}
        Those that do not count although they may be known.
    noun : str
        The word among them that names the thing, as it is spelled; empty if none does, or an
        unknown word may.
    classes : tuple of int
        Those of ImageNet that the noun means; see :mod:`slgaussian.language.nouns`.
    """

    words: tuple[Word, ...]
    unknown: tuple[str, ...]
    unused: Mapping[str, str]
    noun: str = ""
    classes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Vocabulary:
    """Everything in ``vocabulary.toml`` and ``nouns.toml``.

    Attributes
    ----------
    canonical : tuple of str
        Phrases that every query competes with.
    colours : mapping name -> (swatches "#rrggbb", darkest share of light)
    groups : mapping name -> (colour -> weight)
        Kinds of colour.
    words : mapping str -> Word
        By every spelling, synonyms included; neutral words have no weights.
    phrases : mapping tuple of str -> Word
        Several spellings in a row that are one word, stop words among them.
    naming : tuple of str
        Nouns that things are told by when nobody asks for one.
    unseen : mapping str -> str
        Words that are understood but cannot be seen, with the reason.
    stop, relations, negations : frozenset of str
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
    def _lengths(self) -> list[int]:
        """Of how many spellings phrases are, the longest first."""
        return sorted({len(phrase) for phrase in self.phrases}, reverse=True)

    def read(self, text: str) -> Reading:
        """Understand a text as one noun and what describes it.

        Case, accents' encoding and plurals do not matter, stop words are dropped, a repeated word
        counts once. Left out are unknown words; everything from the first relation word on ("on the
        table" describes another object, while "on the left" is a place and counts); and all nouns
        but one: the last, as a plant pot is a pot, or the last before "of", as a picture of a plant
        is a picture. A few compounds are one word, as a trash can is a bin.

        Raises
        ------
        InputError
            If the text is empty, holds a negation, asks for two things, or has neither a word that
        counts nor one that is unknown.
        """
        spelled = spellings(text)
        if not spelled:
            raise InputError(f"query {text!r}: found no word; describe an object, as in 'red ball'")
        for spelling in spelled:
            if spelling in self.negations:
                raise InputError(
                    f"query {_short(text)!r}: {spelling!r} cannot be understood, because objects "
                    "are found by what they are, not by what they are not; leave that part out"
                )
        self._check_one_thing(text, spelled)
        spelled, places = self._take_phrases(spelled)
        end = next((i for i in range(len(spelled)) if self._relates(spelled, i)), len(spelled))
        content = [s for s in spelled[:end] if s not in self.stop]
        looked_up = [(s, self._look_up(s)) for s in _join_names(content)]
        nouns = [i for i, (_, word) in enumerate(looked_up) if word and word.family in NOUNS]
        # In "a picture of a plant" the first thing is meant, in "a plant pot" the last.
        head_limit = len(looked_up)
        if "of" in spelled[:end]:
            head_limit = sum(s not in self.stop for s in spelled[: spelled.index("of")])
        head = next((i for i in reversed(nouns) if i < head_limit), nouns[-1] if nouns else None)
        words = {
            word.name: word
            for i, (_, word) in enumerate(looked_up)
            if word is not None and (i == head or i not in nouns)
        }
        words |= {word.name: word for word in places}
        left_out = [(s, word) for s, word in looked_up if word is None or word.name not in words]
        elsewhere = [s for s in spelled[end:] if s not in self.stop]
        if not words and all(word is not None or s in self.unseen for s, word in looked_up):
            raise unusable(text, [s for s, _ in left_out] + elsewhere)
        unseen = {s: self.unseen[s] for s, _ in left_out if s in self.unseen}
        unknown = [s for s, word in left_out if word is None and s not in unseen]
        sought = "" if head is None else looked_up[head][0]
        unused = {
            s: f"another thing, while {sought!r} is looked for"
            for s, _ in left_out
            if s not in unknown and s not in unseen
        }
        unused |= unseen
        after = f"said of another thing, after {spelled[end]!r}" if elsewhere else ""
        unused |= dict.fromkeys(elsewhere, after)
        head_word = None if head is None else looked_up[head][1]
        classes = () if head_word is None else classes_of(sought) or classes_of(head_word.name)
        # An unknown word after a noun is what the noun describes.
        last = [s for s, _ in looked_up[:head_limit] if s not in unseen][-1:]
        if head is None or set(last) & set(unknown):
            sought, classes = "", ()
        return Reading(
            tuple(words.values()), tuple(dict.fromkeys(unknown)), unused, sought, classes
        )

    def _check_one_thing(self, text: str, spelled: Sequence[str]) -> None:
        """InputError if "and" joins two things."""
        end = next((i for i in range(len(spelled)) if self._relates(spelled, i)), len(spelled))
        for middle in (i for i in range(end) if spelled[i] == "and"):
            sides = spelled[:middle], spelled[middle + 1 : end]
            side_words = [[self._look_up(w) for w in side if self._names(w)] for side in sides]
            nouns = [any(word and word.family in NOUNS for word in side) for side in side_words]
            unknown = bool(side_words[1]) and all(word is None for word in side_words[1])
            if nouns[0] and (nouns[1] or unknown):
                left, right = map(" ".join, sides)
                raise InputError(
                    f"query {_short(text)!r}: asks for two things; ask for {_short(left)!r} and "
                    f"for {_short(right)!r} one at a time"
                )

    def _names(self, spelling: str) -> bool:
        return spelling not in self.stop and spelling not in self.unseen

    def explain(self, text: str) -> tuple[bool, str]:
        """Return whether all of ``text`` is known, and how its words are, in a line."""
        try:
            reading = self.read(text)
        except InputError as refusal:
            return False, f"refused: {refusal}"
        parts = []
        for word in reading.words:
            ways = [f"by its look ({', '.join(word.weights)})"] if word.weights else []
            if reading.noun and word.family in NOUNS and reading.classes:
                count = len(reading.classes)
                ways.append(f"by the classifier ({count} class{'es' * (count > 1)} of ImageNet)")
            parts.append(f"{word.name}, {word.family}: {' and '.join(ways) or 'says nothing'}")
        for spelling in reading.unknown:
            near = self.nearest(spelling)
            parts.append(f"{spelling} is not known{f', did you mean {near!r}?' if near else ''}")
        parts += [f"{word} is set aside: {reason}" for word, reason in reading.unused.items()]
        return not reading.unknown, "; ".join(parts)

    def nearest(self, spelling: str) -> str | None:
        """The known word that is spelled nearly so, None if there is none."""
        if len(spelling) > LONGEST:
            return None
        describing = [*self.words, *self.unseen]
        for spellings in (describing, noun_classes()):
            near = difflib.get_close_matches(spelling, spellings, n=1, cutoff=NEAR)
            if near:
                return near[0]
        return None

    def _relates(self, spelled: Sequence[str], i: int) -> bool:
        """Test whether another object is described next: after "on", or "left of" after a thing."""
        if spelled[i] in self.relations:
            return True
        word = self._look_up(spelled[i])
        of_another = spelled[i + 1 : i + 2] == ["of"] and any(map(self._look_up, spelled[:i]))
        return word is not None and word.family == "place" and of_another

    def families(self) -> dict[str, dict[str, tuple[str, ...]]]:
        """Every word that counts by family, with its synonyms."""
        families: dict[str, dict[str, tuple[str, ...]]] = {}
        for spelling, word in self.words.items():
            if word.weights:
                family = families.setdefault(word.family, {})
                synonyms = family.get(word.name, ())
                family[word.name] = synonyms + ((spelling,) if spelling != word.name else ())
        return families

    def _take_phrases(self, spelled: list[str]) -> tuple[list[str], list[Word]]:
        """The spellings without those of phrases, and the phrases' words.

        A phrase for a thing becomes one spelling among the others. After a relation ("on the table
        on the left") a phrase may be said of the other object, and before "of" ("to the left of the
        door") it is a relation itself.
        """
        left: list[str] = []
        phrase_words: list[Word] = []
        start = 0
        while start < len(spelled):
            word, length = self.phrase_at(spelled, start)
            then = spelled[start + length : start + length + 1]
            place = word is not None and word.family not in NOUNS
            if word is None or (place and then == ["of"]) or not self.relations.isdisjoint(left):
                left.append(spelled[start])
                length = 1
            elif word.family in NOUNS:
                left.append(word.name)
            else:
                phrase_words.append(word)
            start += length
        return left, phrase_words

    def phrase_at(self, spelled: list[str], start: int) -> tuple[Word | None, int]:
        """The longest phrase that begins there, which may be a plural, and how long it is."""
        for length in self._lengths:
            *first, last = spelled[start : start + length]
            for form in _singulars(last):
                if (*first, form) in self.phrases:
                    return self.phrases[*first, form], length
        return None, 0

    def _look_up(self, spelling: str) -> Word | None:
        for form in _singulars(spelling):
            if form in self.words:
                return self.words[form]
        if not classes_of(spelling):
            return None
        *first, last = spelling.split()
        plainer = self._look_up(last) if first else None
        return plainer or Word(spelling, "class", {})


@cache
def load_vocabulary() -> Vocabulary:
    """Read ``vocabulary.toml`` and ``nouns.toml``, which are part of the package."""
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


def spellings(text: str) -> list[str]:
    """The words of a text in lower case, with the apostrophes in them."""
    return _WORD.findall(unicodedata.normalize("NFKC", text).replace("’", "'").lower())


def classes_of(noun: str) -> tuple[int, ...]:
    """The classes of ImageNet that a noun means, which may be a plural; empty if it means none."""
    *first, last = noun.split()
    forms = (" ".join([*first, form]) for form in _singulars(last))
    return next((noun_classes()[form] for form in forms if form in noun_classes()), ())


def _join_names(spelled: Sequence[str]) -> list[str]:
    """Make one of several spellings in a row that name classes together, as "space shuttle"."""
    joined = list(spelled)
    for length in (3, 2):
        for start in range(len(joined) - length, -1, -1):
            name = " ".join(joined[start : start + length])
            if classes_of(name):
                joined[start : start + length] = [name]
    return joined


def _singulars(word: str) -> list[str]:
    """The word and what it may be the plural of, in the order to try them."""
    forms = [word]
    for ending, singular in (("ies", "y"), ("ves", "f"), ("ves", "fe"), ("s", ""), ("es", "")):
        if word.endswith(ending) and len(word) > len(ending) + 1:
            forms.append(word.removesuffix(ending) + singular)
    return forms


def unusable(text: str, words: Sequence[str]) -> InputError:
    """The error of a text of which none of these words can be used."""
    idle = _short(", ".join(words)) or "they carry no meaning here"
    return InputError(
        f"query {_short(text)!r}: none of its words can be used ({idle}); use the lexicon's words, "
        "which `slgaussian words` lists"
    )


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
