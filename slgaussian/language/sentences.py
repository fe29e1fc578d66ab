"""What a text asks of where things are: which of several, related to what, how many.

"Largest chair left of the table" is a chair, left of a table, the largest of those. Only words are
looked at here; what they mean in space is in :mod:`slgaussian.geometry.relations`. A text without
such words is its own noun, letter by letter, and so is one that says a place ("on the left", "on
the floor") or a thing of several words that the lexicon knows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

from slgaussian.language.vocabulary import Vocabulary, load_vocabulary, spellings

SUPERLATIVES = {
    "largest": ("largest", "biggest"),
    "smallest": ("smallest", "tiniest"),
    "nearest": ("nearest", "closest"),
    "farthest": ("farthest", "furthest"),
    "highest": ("highest", "topmost"),
    "lowest": ("lowest", "bottommost"),
    "tallest": ("tallest",),
    "leftmost": ("leftmost",),
    "rightmost": ("rightmost",),
}
"""What one of several things may be, and the words for it."""

RELATIONS = {
    "left of": ("left of", "left side of", "left hand side of"),
    "right of": ("right of", "right side of", "right hand side of"),
    "above": ("above", "over"),
    "below": ("below", "under", "beneath", "underneath"),
    "on": ("on", "on top of"),
    "next to": ("next to", "beside", "near", "near to", "close to", "by", "alongside"),
    "behind": ("behind",),
    "in front of": ("in front of",),
    "nearest to": ("nearest to", "closest to"),
    "farthest from": ("farthest from", "furthest from"),
}
"""How a thing may lie to another one, and the words for it. The last two choose one of several."""

PART = "part of"
"""The relation of the leg of a chair to the chair."""

PARTS = frozenset(
    {
        "leg", "legs", "arm", "arms", "tail", "head", "ear", "ears", "eye", "eyes", "nose", "mouth",
        "paw", "paws", "foot", "feet", "wing", "wings", "hair", "face", "handle", "handles", "lid",
        "knob", "seat", "backrest", "wheel", "wheels", "tyre", "tire", "tyres", "tires", "spout",
        "drawer", "drawers", "windscreen", "windshield", "headlight", "headlights", "leaf",
        "leaves", "petal", "petals", "stem", "trunk", "branch", "branches",
    }
)  # fmt: skip
"""What is said to be of a thing because it is a part of it; a "picture of a plant" is none."""

NUMBERS = {
    word: number
    for number, word in enumerate(
        ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"), 2
    )
}
MOST = 99
"""The greatest number of things that is read in digits."""

_LEADS = (("to", "the"), ("on", "the"), ("at", "the"), ("to",), ())
_IDLE = frozenset({"that", "which", "is", "are", "there", "standing", "lying", "hanging", "placed"})
_PLURALS = frozenset({"people", "children", "men", "women", "mice", "sheep", "geese", "fish"})
_ARTICLES = frozenset({"the", "a", "an", "my", "this", "that"})


@dataclass(frozen=True)
class Sentence:
    """A text as a thing that is asked for among others.

    Attributes
    ----------
    text : str
        All of it, as it was given.
    noun : str
        The thing, with what describes it. ``text`` itself if nothing else was read.
    relation : str
        One of :data:`RELATIONS`, :data:`PART`, or empty.
    anchor : Sentence or None
        What the relation is to.
    superlative : str
        One of :data:`SUPERLATIVES`, or empty.
    count : int or None
        How many are asked for; 0 asks how many there are.
    problem : str
        Why it cannot be answered although its words are known, or empty.
    """

    text: str
    noun: str
    relation: str = ""
    anchor: Sentence | None = None
    superlative: str = ""
    count: int | None = None
    problem: str = ""

    @property
    def plain(self) -> bool:
        """Whether the text asks for a thing and nothing else."""
        return self.noun == self.text


def parse(text: str) -> Sentence:
    """Read a text; whatever it holds, it is at least its own noun.

    The first relation in reading order divides it: a "cup on the table next to the lamp" is a cup
    on a table that is next to a lamp.
    """
    known = load_vocabulary()
    spelled = spellings(text)
    asked = spelled[:2] == ["how", "many"]
    if asked:
        spelled = spelled[2:]
    found = _divide(spelled, known)
    thing, relation, other = found if found else (spelled, "", [])
    if not relation:
        thing, relation, other = _of_a_whole(thing)
    superlatives = [name for s in thing if (name := _superlative(s))]
    thing = [s for s in thing if not _superlative(s)] if superlatives else thing
    while (relation or asked) and thing and thing[-1] in _IDLE:
        thing = thing[:-1]
    count, thing = (0, thing) if asked else _counted(thing)
    if not (relation or superlatives or count is not None):
        return Sentence(text, text)
    if all(s in known.stop or s in _IDLE for s in thing):
        return Sentence(text, text)
    anchor = parse(_named(other)) if relation else None
    superlative = superlatives[0] if superlatives else ""
    read = Sentence(text, _named(thing), relation, anchor, superlative, count)
    return replace(read, problem=_problem(read, superlatives))


def _divide(spelled: list[str], known: Vocabulary) -> tuple[list[str], str, list[str]] | None:
    """The thing, the relation and the other thing; None if there is no relation between two."""
    at = 0
    while at < len(spelled):
        relation, length = _relation(spelled, at)
        phrase, covered = known.phrase_at(spelled, at)
        then = spelled[at + covered : at + covered + 1]
        if phrase is not None and covered >= length and then != ["of"]:
            at += covered
            continue
        if relation:
            thing, other = spelled[:at], spelled[at + length :]
            both = (any(s not in known.stop for s in side) for side in (thing, other))
            if all(both):
                return thing, relation, other
        at += max(length, 1)
    return None


@cache
def _ways() -> Mapping[str, Sequence[tuple[str, list[str]]]]:
    """Relations, and the words that say them, by the first of these."""
    found: dict[str, list[tuple[str, list[str]]]] = {}
    for relation, ways in RELATIONS.items():
        side = relation in ("left of", "right of")
        for way in ways:
            for lead in _LEADS if side else ((),):
                words = [*lead, *way.split()]
                found.setdefault(words[0], []).append((relation, words))
    return found


def _relation(spelled: list[str], at: int) -> tuple[str, int]:
    """The relation whose words begin there, the longest, and how many they are."""
    best = "", 0
    for relation, words in _ways().get(spelled[at], ()):
        then = spelled[at + len(words) : at + len(words) + 1]
        if words == ["by"] and not _ARTICLES.intersection(then):
            continue  # "a painting by Rembrandt"
        if spelled[at : at + len(words)] == words and len(words) > best[1]:
            best = relation, len(words)
    if not best[1] and at and spelled[at + 1 : at + 2] and spelled[at + 1] in _ARTICLES:
        # "the chair nearest the door"
        for relation in ("nearest to", "farthest from"):
            if _superlative(spelled[at]) == relation.split()[0]:
                return relation, 1
    return best


def _of_a_whole(thing: list[str]) -> tuple[list[str], str, list[str]]:
    """The part, :data:`PART` and the whole of "leg of the chair" and "the fox's tail".

    The thing itself if it is none. A "head of lettuce" is none, nor are "men's shoes".
    """
    for at, spelling in enumerate(thing[:-1]):
        of = at > 0 and spelling == "of" and len(thing) > at + 2
        if of and thing[at - 1] in PARTS and thing[at + 1] in _ARTICLES:
            return thing[:at], PART, thing[at + 1 :]
        owner = spelling.removesuffix("'s")
        if owner not in ("", spelling) and thing[-1] in PARTS:
            return thing[at + 1 :], PART, [*thing[:at], owner]
    return thing, "", []


def _named(thing: list[str]) -> str:
    """A thing without its article: so it may be a name that the user gave."""
    while len(thing) > 1 and thing[0] in _ARTICLES:
        thing = thing[1:]
    return " ".join(thing)


def _superlative(spelling: str) -> str:
    return next((name for name, ways in SUPERLATIVES.items() if spelling in ways), "")


def _counted(thing: list[str]) -> tuple[int | None, list[str]]:
    """How many of a thing are asked for, if any number is, and the thing."""
    first = 1 if thing[:1] == ["the"] else 0
    many = thing and (thing[-1] in _PLURALS or (thing[-1][-1] == "s" and thing[-1][-2:] != "ss"))
    if len(thing) <= first + 1 or not many:
        return None, thing  # a "two seat sofa" is one
    said = thing[first]
    number = NUMBERS.get(said)
    if number is None and said.isascii() and said.isdecimal() and len(said) <= 2:
        number = int(said)
    if number is None or not 2 <= number <= MOST:
        return None, thing
    return number, thing[first + 1 :]


def _problem(read: Sentence, superlatives: list[str]) -> str:
    if len(superlatives) > 1:
        return f"only one of {' and '.join(superlatives)} can be asked for at a time"
    if superlatives and read.count == 0:
        return f"{superlatives[0]!r} chooses one of several, so there is nothing to count"
    if read.relation in ("nearest to", "farthest from") and (superlatives or read.count == 0):
        return f"{read.relation!r} chooses one of several, and more is asked for"
    if read.anchor is not None and read.anchor.count is not None:
        return f"things lie {read.relation!r} one thing here, not several; leave out how many"
    if read.anchor is not None:
        return read.anchor.problem
    return ""
