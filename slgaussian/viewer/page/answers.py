"""Texts that a page can answer, with their answers, computed when the page is written.

A page contains no encoder. With a vocabulary it answers every word, every colour with every noun
("red car"), and every other describing word with every common noun ("striped chair"); without one,
some common nouns; and with both the words and names that the user added.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.language.answer import QueryResult, ask
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.vocabulary import NOUN_FAMILIES
from slgaussian.language.wholes import MIN_PIXELS

MAX_PAIR_ANSWERS = 2**20
"""Largest number of pairs of words times objects; if there are more, the page answers no pairs."""


class PageAnswers:
    """Answers for the whole scene, in the form that ``words.js`` reads.

    Args:
        ids: Ids of the objects of the page, ascending.
        view: int32 [H, W]. Ids of the first view, by which objects touch.
    """

    def __init__(self, ids: Sequence[int], view: np.ndarray) -> None:
        self.ids = ids
        self._view = np.where(np.isin(view, ids), view, 0)

    def ask(self, field: SemanticField, texts: Sequence[str]) -> list[dict[str, Any]]:
        """Answer texts by the objects that are not removed, as if a view showed enough of each.

        Returns:
            For each text: ``text``; ``kind``, ``unknown``, ``score``, ``verdict``, ``shown`` and
            ``summary`` of :class:`slgaussian.language.answer.QueryResult`; its ``confidence`` as
            [mask, point], or None; ``scores`` of the objects of the page; and ``taken``, the
            indices of those that the answer selects, best first.

        Raises:
            InputError: If the encoder cannot use a text.
        """
        present = np.isin(field.bank.ids, self.ids) & ~np.isin(
            field.bank.ids, list(field.edits.removed)
        )
        image = ObjectMap(self._view, field.bank.ids, MIN_PIXELS * present)
        rows = np.searchsorted(field.bank.ids, np.array(self.ids, field.bank.ids.dtype))
        hits = ask(texts, image, field.reader, Rules())
        return [self._encode(hit, np.where(present, hit.scores, 0)[rows]) for hit in hits]

    def _encode(self, hit: QueryResult, scores: np.ndarray) -> dict[str, Any]:
        names = ("text", "kind", "unknown", "verdict", "shown", "summary")
        return {
            **{name: getattr(hit, name) for name in names},
            "score": round(hit.score, 6),
            "confidence": hit.confidence and [round(p, 6) for p in hit.confidence],
            "scores": np.round(scores, 6).tolist(),
            "taken": [self.ids.index(id_) for id_, _ in hit.objects],
        }


def list_texts(
    field: SemanticField, ids: Sequence[int], extra: Sequence[str] = ()
) -> dict[str, Any]:
    """List the texts that a page with the objects ``ids`` answers.

    Returns:
        dict of JSON data for the page. ``texts`` in lower case; ``words``, the kind of each text
        that is not a pair: ``thing`` (noun), ``describing``, ``taught``, ``named`` or ``text``;
        ``spellings``, the word of each; ``skipped``, words without meaning; ``pairs``, whether
        pairs of a describing word and a noun are answered.

    Raises:
        InputError: If the encoder is not installed, or cannot use an ``extra`` text.
    """
    kinds: dict[str, str] = {}
    spellings: dict[str, str] = {}
    skipped: list[str] = []
    pairs: list[str] = []
    if (vocabulary := field.encoder.vocabulary) is None:
        kinds |= dict.fromkeys(field.encoder.describing, "text")
    else:
        skipped = sorted({*vocabulary.stop, *vocabulary.unseen})
        phrases = {" ".join(phrase): word for phrase, word in vocabulary.phrases.items()}
        for spelling, word in sorted({**vocabulary.words, **phrases}.items()):
            if word.weights:
                kinds[word.name] = "thing" if word.family in NOUN_FAMILIES else "describing"
                spellings[spelling] = word.name
        spellings |= {name: name for name in kinds}
        things = sorted(word for word, kind in kinds.items() if kind == "thing")
        describing = sorted(kinds.keys() - things)
        pairs = [
            f"{word} {noun}"
            for word in describing
            for noun in (things if word in vocabulary.colours else vocabulary.naming)
        ]
        if len(pairs) * len(ids) > MAX_PAIR_ANSWERS:
            pairs = []
    for text in extra:
        if untold := field.reader.understood(text).untold:
            raise InputError(f"text {text!r}: {untold}")
    kinds |= {_plain(text): "text" for text in extra if _plain(text) not in kinds}
    kinds |= {_plain(word): "taught" for word in field.edits.taught}
    names = field.edits.names
    kinds |= {_plain(names[id_]): "named" for id_ in ids if id_ in names}
    return {
        "pairs": bool(pairs),
        "texts": list(dict.fromkeys([*kinds, *pairs])),
        "words": kinds,
        "spellings": spellings,
        "skipped": skipped,
    }


def _plain(text: str) -> str:
    return " ".join(text.lower().split())
