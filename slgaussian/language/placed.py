"""Answers to texts that say where things are to one another, which of several, or how many.

Words find objects, as for any text; objects in contact are one thing; and geometry decides which of
these things are meant. What geometry cannot decide is said and not guessed: if that which a
relation is to is not found, nothing is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from slgaussian.geometry import relations
from slgaussian.geometry.relations import Extent
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import BankReader, QueryResult, Rules, answer, ask, chosen_by
from slgaussian.language.sentences import PART, Sentence
from slgaussian.scene import Camera

LEAST = 0.001
"""A thing has at least so much of the view: what is smaller is a sliver and not counted."""

EVEN = 0.5
"""Relevancy of what fits the words and does not lie as they say, at most."""

CAMERAS = frozenset(
    {"left of", "right of", "behind", "in front of", "nearest", "farthest", "leftmost", "rightmost"}
)
"""Words that depend on who looks."""


class Layout:
    """Where the objects of a bank are, as a camera sees them.

    Parameters
    ----------
    camera : Camera
    up : callable
        Gives the unit vector [3] away from the floor, in world coordinates; asked when needed.
    points : callable
        Gives points float [P, 3] on the surface of an object, by its place in the bank.
    """

    def __init__(
        self,
        camera: Camera,
        up: Callable[[], np.ndarray],
        points: Callable[[int], np.ndarray],
    ) -> None:
        self.camera, self._up, self.points = camera, up, points
        self._extents: dict[tuple[int, ...], Extent] = {}

    @cached_property
    def up(self) -> np.ndarray:
        """Unit vector float64 [3] away from the floor."""
        return self._up()

    def extent(self, rows: np.ndarray) -> Extent:
        """That of the objects at these places int [M] of the bank; one at least has points."""
        key = tuple(rows.tolist())
        if key not in self._extents:
            points = np.concatenate([self.points(row) for row in key])
            self._extents[key] = relations.extent(points, self.camera, self.up)
        return self._extents[key]

    def things(self, rows: np.ndarray) -> list[np.ndarray]:
        """Places int [M] in the bank by things, in the order of their first; those without points
        are none."""
        rows = np.array([row for row in rows if len(self.points(row))], np.int64)
        numbers = relations.joined([self.points(row) for row in rows])
        first = np.unique(numbers, return_index=True)[1]
        return [rows[numbers == numbers[start]] for start in np.sort(first)]


def ask_placed(
    texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules, layout: Layout
) -> list[QueryResult]:
    """Find what each text describes; one that says nothing of where things are as :func:`ask` does.

    Raises
    ------
    InputError
        If there is no text, the encoder cannot use one, or one asks for what cannot be answered.
    """
    sentences = {text: reader.sentence(text) for text in texts}
    plain = [text for text in texts if sentences[text].plain]
    if len(plain) == len(texts):
        return ask(texts, seen, reader, rules)
    hits = dict(zip(plain, ask(plain, seen, reader, rules), strict=True)) if plain else {}
    asker = _Asker(seen, reader, rules, layout)
    return [hits.get(text) or asker.answer(sentences[text]) for text in texts]


@dataclass(frozen=True, eq=False)
class _Asker:
    seen: ObjectMap
    reader: BankReader
    rules: Rules
    layout: Layout

    def answer(self, sentence: Sentence) -> QueryResult:
        read = self.reader.meant(sentence.text)
        found = self._plain(sentence.noun) if sentence.plain else self._placed(sentence)
        return replace(found, text=sentence.text, understood=read)

    def _plain(self, text: str) -> QueryResult:
        return ask([text], self.seen, self.reader, self.rules)[0]

    def _placed(self, sentence: Sentence) -> QueryResult:
        gaps = self.reader.gaps([sentence.noun], self.rules)[0]
        anchor, taken = None, np.zeros(len(gaps), bool)
        notes = []
        if sentence.anchor is not None:
            other = self.answer(sentence.anchor)
            if other.verdict == "not here":
                gone = f"{sentence.anchor.text!r} is probably not here"
                return self._nothing(sentence, gaps, (gone, *other.notes))
            rows = self._meant(other)
            if not len(rows):
                small = f"{sentence.anchor.text!r} is too small here to say where it is"
                return self._nothing(sentence, gaps, (small,))
            if other.verdict == "not sure":
                notes.append(f"it is not sure where {sentence.anchor.text!r} is")
            anchor = self.layout.extent(rows)
            taken[rows] = sentence.relation != PART
        things, left = self._holding(sentence, gaps, anchor, ~taken)
        if not things:
            return self._nothing(sentence, gaps, (self._none(sentence), *notes))
        if sentence.superlative or sentence.relation in ("nearest to", "farthest from"):
            how = sentence.superlative or sentence.relation.split()[0]
            towards = None if sentence.superlative else anchor
            ranks = relations.order(how, [self.layout.extent(one) for one in things], towards)
            if len(things) == 1:
                notes.append(f"only one was found, so it is the {how}")
            things = [things[rank] for rank in ranks[: sentence.count or 1]]
        elif sentence.count:
            best = [-gaps[one].max() for one in things]
            things = [things[rank] for rank in np.argsort(best, kind="stable")[: sentence.count]]
        kept = np.zeros(len(gaps), bool)
        kept[np.concatenate(things)] = True
        hit = one = self._result(sentence, gaps, kept, left)
        if sentence.count == 0:
            # That there are several speaks against an answer, but not against one of them.
            likest = max(things, key=lambda rows: gaps[rows].max())
            one = self._result(sentence, gaps, np.isin(np.arange(len(gaps)), likest), left)
        count, said = self._counted(sentence, things, one)
        return replace(hit, count=count, notes=(*notes, *said))

    def _holding(
        self, sentence: Sentence, gaps: np.ndarray, anchor: Extent | None, free: np.ndarray
    ) -> tuple[list[np.ndarray], np.ndarray]:
        """The things that fit the noun and lie as they should, and what else may be meant.

        Those that fit the noun best may all lie elsewhere; then those that fit next are looked at.
        """
        left = free & (self.seen.areas > 0)
        related = anchor is not None and sentence.relation not in ("nearest to", "farthest from")
        while True:
            open_ = np.where(left, gaps, -np.inf)
            chosen = np.flatnonzero(chosen_by(self.rules, open_, open_.max(initial=-np.inf)) & left)
            chosen = chosen[np.argsort(-gaps[chosen], kind="stable")]
            left[chosen] = False
            if sentence.relation == PART:
                things = [
                    np.array([row]) for row in chosen.tolist() if len(self.layout.points(row))
                ]
            else:
                things = self.layout.things(chosen)
            least = LEAST * self.seen.rows.size
            things = [one for one in things if self.seen.areas[one].sum() >= least]
            if related:
                assert anchor is not None
                up = self.layout.up
                things = [
                    one
                    for one in things
                    if relations.holds(sentence.relation, self.layout.extent(one), anchor, up)
                ]
            if things or not len(chosen) or not related:
                return things, left

    def _meant(self, hit: QueryResult) -> np.ndarray:
        """The thing that an answer points at: places in the bank."""
        point = hit._ranked[: hit._as_good]
        first = int(point[self.seen.areas[point].argmax()])
        chosen = np.flatnonzero(hit._chosen & (self.seen.areas > 0))
        things = self.layout.things(chosen)
        none = np.zeros(0, np.int64)
        return next((one for one in things if first in one), none)

    def _result(
        self, sentence: Sentence, gaps: np.ndarray, kept: np.ndarray, left: np.ndarray
    ) -> QueryResult:
        """The answer that takes what is ``kept``; what else fitted the noun is dropped."""
        open_ = np.where(kept | left, gaps, -np.inf)
        hit = answer(sentence.noun, open_, self.seen, self.reader, self.rules)
        ranked = hit._ranked[np.argsort(~kept[hit._ranked], kind="stable")]
        dropped = ~kept & ~left & (gaps > -np.inf)
        plain = self.reader.relevancies([sentence.noun], self.rules)[0]
        scores = np.where(dropped, np.minimum(plain, EVEN), plain)
        return replace(
            hit,
            scores=scores,
            _ranked=ranked,
            _as_good=min(hit._as_good, int(kept[ranked].sum())),
            _chosen=kept,
        )

    def _nothing(self, sentence: Sentence, gaps: np.ndarray, notes: tuple[str, ...]) -> QueryResult:
        # The mask of ``langsplat`` is never empty.
        rules = replace(self.rules, protocol="slgaussian")
        hit = answer(sentence.noun, gaps, self.seen, self.reader, rules)
        none = np.zeros(len(gaps), bool)
        scores = np.minimum(hit.scores, EVEN)
        count = None if sentence.count is None else 0
        return replace(hit, scores=scores, _chosen=none, confidence=None, count=count, notes=notes)

    def _none(self, sentence: Sentence) -> str:
        if sentence.anchor is None:
            return f"nothing fits {sentence.noun!r}"
        return (
            f"nothing that fits {sentence.noun!r} is {sentence.relation} {sentence.anchor.text!r}"
        )

    def _counted(
        self, sentence: Sentence, things: list[np.ndarray], best: QueryResult
    ) -> tuple[int | None, list[str]]:
        """How many things were found, if that is asked, and what there is to say of an answer.

        ``best`` is the answer that takes the best of them alone.
        """
        count, notes = None, []
        if sentence.count is not None:
            count = len(things)
            if sentence.count == 0 and best.verdict == "not here":
                count = 0
                notes.append("what was found is probably something else")
            if count < sentence.count:
                notes.append(f"{count} found, not {sentence.count}")
            cut = sum(self.layout.extent(one).cut for one in things)
            if count:
                notes.append("things that touch count as one")
            if count and cut:
                notes.append(f"{cut} of them cut by the edge of the picture")
        if {sentence.relation.split(" to")[0].split(" from")[0], sentence.superlative} & CAMERAS:
            notes.append("as this camera sees it")
        return count, notes
