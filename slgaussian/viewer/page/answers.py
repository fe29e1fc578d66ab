"""Texts that a page can be asked, with the answer of every object computed beforehand.

A page holds no encoder. Of the lexicon it knows every word, every colour with every thing ("red
car") and every describing word with every common thing ("striped chair"); of another encoder some
common things. What a user taught, and the names that he gave, it knows too. The answers are
relevancy gaps (:mod:`slgaussian.language.relevancy`), by which the page says how sure it is
(:mod:`slgaussian.language.confidence`), and what an answer takes of all that it shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.language.confidence import Calibration
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.rules import Rules, unmeasured
from slgaussian.language.vocabulary import NOUNS, load_vocabulary
from slgaussian.language.wholes import LEAST_PIXELS
from slgaussian.objects import words_for

MOST = 2**20
"""Numbers that answers to pairs of words may take; without room for all pairs there are none."""


@dataclass(frozen=True, eq=False)
class Answers:
    """Words of a page and their answers.

    Attributes
    ----------
    texts : tuple of str
        What was asked, in lower case.
    gaps : float32 [texts, things]
        -inf for a thing that no view holds.
    taken : bool [texts, things]
        What each answer takes.
    kinds : {word: kind}
        Of the texts that are single words or whole phrases: ``thing``, ``describing``, ``taught``,
        ``named`` or ``text``.
    spellings : {spelling: word}
        Other ways to write words.
    skipped : tuple of str
        Words that carry no meaning.
    pairs : bool
        Whether a colour and a thing, or a describing word and a common thing, are answered
        together.
    measurements : tuple of int
        How many each text asks for.
    named : tuple of float
        By how much the classifier names some thing so, as
        :class:`slgaussian.language.confidence.Signs` has it.
    calibration : Calibration or None
        Of the encoder.
    uncalibrated : str
        For what there is none, such as ``the encoder clip``.
    """

    texts: tuple[str, ...]
    gaps: np.ndarray
    taken: np.ndarray
    kinds: Mapping[str, str]
    spellings: Mapping[str, str]
    skipped: tuple[str, ...]
    pairs: bool
    measurements: tuple[int, ...] = ()
    named: tuple[float, ...] = ()
    calibration: Calibration | None = None
    uncalibrated: str = ""


def answers_of(
    field: SemanticField, ids: Sequence[int], more: Sequence[str] = (), live: bool = False
) -> Answers:
    """Compute the answers of the objects ``ids`` to all that a page can be asked, and to ``more``.

    A ``live`` page asks its server: of texts it has only the words of a lexicon, to offer them.
    InputError if the encoder cannot use one of these, knows nothing of it, or is not there.
    """
    kinds: dict[str, str] = {}
    spellings: dict[str, str] = {}
    skipped: tuple[str, ...] = ()
    pairs: list[str] = []
    if isinstance(field.encoder, Lexicon):
        vocabulary = load_vocabulary()
        skipped = tuple(sorted({*vocabulary.stop, *vocabulary.unseen}))
        every = {
            **vocabulary.words,
            **{" ".join(p): word for p, word in vocabulary.phrases.items()},
        }
        for spelling, word in sorted(every.items()):
            if word.weights:
                kinds[word.name] = "thing" if word.family in NOUNS else "describing"
                spellings[spelling] = word.name
        spellings |= {name: name for name in kinds}
        things = sorted(word for word, kind in kinds.items() if kind == "thing")
        describing = sorted(word for word, kind in kinds.items() if kind == "describing")
        pairs = [
            f"{word} {noun}"
            for word in describing
            for noun in (things if word in vocabulary.colours else vocabulary.naming)
        ]
        if len(pairs) * len(ids) > MOST:
            pairs = []
    else:
        kinds |= dict.fromkeys(words_for(field.encoder), "text")
    calibration, doubt = field.encoder.calibration, unmeasured(field.encoder, Rules())
    if live:
        nothing = np.zeros((0, len(ids)), np.float32)
        offered = Answers((), nothing, nothing > 0, kinds, {}, (), bool(pairs))
        return replace(offered, calibration=calibration, uncalibrated=doubt)
    for text in more:
        if untold := field.reader.understood(text).untold:
            raise InputError(f"text {text!r}: {untold}")
    kinds |= {_plain(text): "text" for text in more if _plain(text) not in kinds}
    kinds |= {_plain(word): "taught" for word in field.taught}
    kinds |= {_plain(field.names[id_]): "named" for id_ in ids if id_ in field.names}
    texts = tuple(dict.fromkeys([*kinds, *pairs]))
    rows = np.searchsorted(field.bank.ids, np.array(ids, field.bank.ids.dtype))
    gaps, selected = np.zeros((2, len(texts), 0))
    if len(ids):
        reader, areas = field.reader, np.zeros(len(field.bank), int)
        areas[rows] = LEAST_PIXELS
        gaps = reader.gaps(texts, Rules())
        selected = reader.chosen(texts, gaps, areas, Rules())[:, rows]
        gaps = gaps[:, rows]
    known_as = texts, gaps.astype(np.float32), selected > 0, kinds, spellings, skipped
    read = [field.reader.understood(text) for text in texts]
    measurements = tuple(reading.measurements for reading in read)
    named = tuple(reading.named for reading in read)
    return Answers(*known_as, bool(pairs), measurements, named, calibration, doubt)


def _plain(text: str) -> str:
    return " ".join(text.lower().split())
