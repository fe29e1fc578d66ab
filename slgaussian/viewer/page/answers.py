"""Texts that a page can answer, with their answers, computed when the page is written.

A page contains no encoder. With the lexicon it answers every word, every colour with every noun
("red car"), and every other describing word with every common noun ("striped chair"); with another
encoder, some common nouns; and with both the words and names that the user added. An answer is a
relevancy gap for each object (:mod:`slgaussian.language.relevancy`), from which the page computes
its confidence (:mod:`slgaussian.language.confidence`), and the objects that it selects.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.language.confidence import (
    MIN_POINT_PROBABILITY,
    STD_OFFSET,
    TYPICAL_STAND_OUT,
    Calibration,
)
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.rules import Rules, unmeasured
from slgaussian.language.vocabulary import NOUN_FAMILIES, load_vocabulary
from slgaussian.language.wholes import MIN_PIXELS
from slgaussian.objects import words_for

MAX_PAIR_ANSWERS = 2**20
"""Largest number of pairs of words times objects; if there are more, the page answers no pairs."""


def compute_answers(
    field: SemanticField, ids: Sequence[int], extra: Sequence[str] = (), live: bool = False
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Compute the answers of the objects ``ids`` to all texts of a page and to ``extra`` texts.

    A ``live`` page asks its server: it has no answers, only the encoder's words as suggestions.

    Returns:
        about: dict of JSON data for the page. ``texts`` in lower case; ``words``, the kind of each
            text that is not a pair: ``thing`` (noun), ``describing``, ``taught``, ``named`` or
            ``text``; ``spellings``, the word of each; ``skipped``, words without meaning;
            ``pairs``, whether pairs of a describing word and a noun are answered; for each text
            ``measurements`` and ``named`` of :class:`slgaussian.language.confidence.Signs`;
            ``calibration`` of confidence, or ``uncalibrated``, the part without one.
        gaps: float32 [texts, things]. Relevancy gaps; -inf for an object that no view shows.
        selected: bool [texts, things]. Whether the answer selects the object.

    Raises:
        InputError: If the encoder is not installed, or cannot use a text or knows none of it.
    """
    kinds: dict[str, str] = {}
    spellings: dict[str, str] = {}
    skipped: list[str] = []
    pairs: list[str] = []
    if isinstance(field.encoder, Lexicon):
        vocabulary = load_vocabulary()
        skipped = sorted({*vocabulary.stop, *vocabulary.unseen})
        entries = {
            **vocabulary.words,
            **{" ".join(p): word for p, word in vocabulary.phrases.items()},
        }
        for spelling, word in sorted(entries.items()):
            if word.weights:
                kinds[word.name] = "thing" if word.family in NOUN_FAMILIES else "describing"
                spellings[spelling] = word.name
        spellings |= {name: name for name in kinds}
        things = sorted(word for word, kind in kinds.items() if kind == "thing")
        describing = sorted(word for word, kind in kinds.items() if kind == "describing")
        pairs = [
            f"{word} {noun}"
            for word in describing
            for noun in (things if word in vocabulary.colours else vocabulary.naming)
        ]
        if len(pairs) * len(ids) > MAX_PAIR_ANSWERS:
            pairs = []
    else:
        kinds |= dict.fromkeys(words_for(field.encoder), "text")
    data: dict[str, Any] = {
        "pairs": bool(pairs),
        "calibration": _curves(field.encoder.calibration),
        "uncalibrated": unmeasured(field.encoder, Rules()),
    }
    if live:
        empty = {name: list[Any]() for name in ("texts", "skipped", "measurements", "named")}
        data |= {**empty, "words": kinds, "spellings": {}}
        return data, np.zeros((0, len(ids)), np.float32), np.zeros((0, len(ids)), bool)
    for text in extra:
        if untold := field.reader.understood(text).untold:
            raise InputError(f"text {text!r}: {untold}")
    kinds |= {_plain(text): "text" for text in extra if _plain(text) not in kinds}
    kinds |= {_plain(word): "taught" for word in field.taught}
    kinds |= {_plain(field.names[id_]): "named" for id_ in ids if id_ in field.names}
    texts = list(dict.fromkeys([*kinds, *pairs]))
    rows = np.searchsorted(field.bank.ids, np.array(ids, field.bank.ids.dtype))
    gaps, selected = np.zeros((2, len(texts), 0))
    if len(ids):
        reader, areas = field.reader, np.zeros(len(field.bank), int)
        areas[rows] = MIN_PIXELS
        gaps = reader.gaps(texts, Rules())
        selected = reader.chosen(texts, gaps, areas, Rules())[:, rows]
        gaps = gaps[:, rows]
    readings = [field.reader.understood(text) for text in texts]
    data |= {"texts": texts, "words": kinds, "spellings": spellings, "skipped": skipped}
    data["measurements"] = [reading.measurements for reading in readings]
    data["named"] = [round(reading.named, 3) for reading in readings]
    return data, gaps.astype(np.float32), selected > 0


def _curves(calibration: Calibration | None) -> dict[str, Any] | None:
    """Return the constants with which ``words.js`` computes confidence."""
    if calibration is None:
        return None
    return {
        "mask": list(calibration.mask),
        "point": list(calibration.point),
        "absent": MIN_POINT_PROBABILITY,
        "typical": TYPICAL_STAND_OUT,
        "even_out": STD_OFFSET,
    }


def _plain(text: str) -> str:
    return " ".join(text.lower().split())
