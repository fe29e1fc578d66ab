"""Readers of texts: what an encoder understands, and what the objects of a bank say to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language import Encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.language.class_evidence import evidence, log_probability
from slgaussian.language.confidence import NEUTRAL_LOG_PROBABILITY, TYPICAL_MEASUREMENTS
from slgaussian.language.relevancy import SOFT, Scorer, sigmoid
from slgaussian.language.rules import Rules, unmeasured
from slgaussian.language.taught import TaughtWords, normal, spelled
from slgaussian.language.wholes import Candidates, near_best

CLASS_LEAD = 0.1
"""Lead in cosine that classes give a look at most, where the text is a noun alone. Fitted, with the
next two, on labelled photographs: of any place left out the others choose nearly the same."""

CLASS_SCALE = 3.0
"""Nats of evidence for classes that give three quarters of that lead."""

DESCRIBED = 0.5
"""Each word that describes the noun counts this much of it: a described thing is less told by what
it is called."""

NAMED = 10.0
"""Gap of an object that the user called so, and minus it that of all others: far beyond cosines, so
that the relevancy is 1 or 0 at any temperature in use."""

CACHE_SIZE = 4096
"""Texts whose vectors a reader keeps."""


@dataclass(frozen=True)
class Understood:
    """The words of a text as an encoder reads them.

    Attributes
    ----------
    read_as : str
        Those that count, in words of the encoder.
    unknown : tuple of str
        Those that it does not know and leaves out.
    unused : {word: why}
        Others that do not count, though it may know them: "plant" of "plant pot".
    kind : str
        ``known``: the encoder answers, and knows every word that counts. ``unknown``: it answers,
        but there are words that it does not know and leaves out. ``taught``: the text is a word
        that a user taught, and its examples answer. ``picture``: a picture or an object was asked
        for, no text.
    examples : int
        Of a taught word, how many examples answer.
    instead_of : str
        Of a name or a taught word that the encoder knows too: what it would have read.
    measurements : int
        How many the text asks for, or as many as most do where nobody counts them.
    named : float
        By how much the classifier names some object so; see
        :class:`slgaussian.language.confidence.Signs`.
    describing : int
        How many words describe the noun.
    untold : str
        Why nothing can be said of what the text asks for; empty if something can.
    question : str
        Known words that may be meant by unknown ones, as the end of a sentence.
    """

    read_as: str
    unknown: tuple[str, ...]
    unused: Mapping[str, str]
    kind: str = "known"
    examples: int = 0
    instead_of: str = ""
    measurements: int = TYPICAL_MEASUREMENTS
    named: float = 0.0
    describing: int = 0
    untold: str = ""
    question: str = ""

    @property
    def alone(self) -> str:
        """That unknown words are left out, as the end of a sentence; empty if none is."""
        return f", for {self.read_as!r} alone{self.question}" if self.unknown else ""


class TextReader:
    """An encoder that remembers what it read.

    Texts are encoded one by one, so that an answer does not depend on what else is asked.
    """

    by_class = False
    """Whether a classifier has seen what is asked about."""

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        self._read = lru_cache(CACHE_SIZE)(self._encode)

    def vectors(self, texts: Sequence[str]) -> np.ndarray:
        """Unit vectors float32 [Q, C] of texts.

        Raises
        ------
        InputError
            If there is no text, or the encoder cannot use one.
        """
        if isinstance(texts, str) or not len(texts):
            problem = "one text" if isinstance(texts, str) else "no text"
            raise InputError(f"query: found {problem}, expected a list of at least one")
        return np.stack([self._read(text)[0] for text in texts])

    def phrases(self, rules: Rules) -> tuple[str, ...]:
        """The canonical phrases that ``rules`` ask for."""
        return rules.phrases or tuple(self.encoder.canonical)

    def understood(self, text: str) -> Understood:
        """Read ``text``: what counts and what does not; InputError if the encoder cannot use it."""
        return self._read(text)[1]

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that the encoder leaves out, as it does not know them."""
        return self._read(text)[1].unknown

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        encoder = self.encoder
        untold = getattr(encoder, "untold", lambda *_: "")(text, self.by_class)
        read_as, unknown = encoder.read_as(text), encoder.unknown_words(text)
        # Of what nothing is known, nothing is said: as much as any phrase.
        vector = encoder.encode_text([text if read_as or not untold else encoder.canonical[0]])[0]
        return vector, Understood(
            read_as,
            unknown,
            encoder.unused_words(text),
            "unknown" if unknown else "known",
            measurements=getattr(encoder, "measurements", lambda _: TYPICAL_MEASUREMENTS)(text),
            describing=getattr(encoder, "describing", lambda _: 0)(text),
            untold=untold,
            question=getattr(encoder, "question", lambda _: "")(text) if unknown else "",
        )


class BankReader(TextReader):
    """A memory bank and the encoder that built it: what objects have to say to texts.

    What the canonical phrases score is remembered too. A text that is one of the ``names`` {id:
    name} means the objects called so and no others; one of the ``taught`` words is answered by
    their examples.
    """

    def __init__(
        self,
        bank: MemoryBank,
        encoder: Encoder,
        taught: TaughtWords | None = None,
        names: Mapping[int, str] | None = None,
    ) -> None:
        super().__init__(encoder)
        self.bank = bank
        self.by_class = bank.class_scores is not None
        self._present = bank.nodes[1]
        self.taught = TaughtWords() if taught is None else taught
        self._called: dict[str, list[int]] = {}
        for id_, name in (names or {}).items():
            self._called.setdefault(spelled(name), []).append(id_)
        self._scorer = lru_cache(4)(self._make_scorer)

    def gaps(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Relevancy gaps float64 [Q, N] of texts to the objects of the bank.

        Raises
        ------
        InputError
            If there is no text, or the encoder cannot use one.
        """
        scorer = self._scorer(self.phrases(rules), rules.absent)
        if isinstance(texts, str) or not len(texts):
            self.vectors(texts)  # which says what is wrong
        gaps = np.empty((len(texts), len(self.bank)))
        rows: dict[str, list[int]] = {"named": [], "taught": [], "known": []}
        for k, text in enumerate(texts):
            rows[self._who(text)].append(k)
        if rows["known"]:
            encoded = [texts[k] for k in rows["known"]]
            class_leads = np.stack([self.class_leads(text)[self._present] for text in encoded])
            gaps[rows["known"]] = scorer.gaps(self.vectors(encoded), class_leads)
        if rows["taught"]:
            leads = [self.taught.leads(texts[k], scorer.looks) for k in rows["taught"]]
            gaps[rows["taught"]] = scorer.combined(np.stack(leads))
        for k in rows["named"]:
            mine = np.isin(self.bank.ids, self._called[spelled(texts[k])])
            gaps[k] = np.where(mine, NAMED, -NAMED)
        return gaps

    def class_leads(self, text: str) -> np.ndarray:
        """Compute what the classifier adds to the leads of a text, float64 [M, V].

        Zero where the noun is none of its classes, or nothing was classified.
        """
        strength = CLASS_LEAD / (1 + DESCRIBED * super().understood(text).describing)
        leads: np.ndarray = strength * np.tanh(self.class_evidence(text) / CLASS_SCALE)
        return leads

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        vector, read = super()._encode(text)
        likeliest = self._likeliest(text)
        return vector, read if likeliest is None else replace(
            read, named=likeliest - NEUTRAL_LOG_PROBABILITY
        )

    def _likeliest(self, text: str) -> float | None:
        """Log-probability of the noun's classes in the object that has most of it."""
        classes = getattr(self.encoder, "classes", lambda _: ())(text)
        if not classes or self.bank.class_scores is None or not self.bank.present.any():
            return None
        objects = self.bank.class_scores[: len(self.bank)][self.bank.present]
        return float(log_probability(objects, classes).max())

    def class_evidence(self, text: str) -> np.ndarray:
        """Compute how much likelier the noun's classes are there than in whole photographs, nats.

        float64 [M, V] over ``bank.nodes``, see :func:`slgaussian.language.class_evidence.evidence`;
        zeros if there are none, or nothing was classified. InputError if the text cannot be used.
        """
        bank = self.bank
        classes = getattr(self.encoder, "classes", lambda _: ())(text)
        if not classes or bank.class_scores is None or bank.photograph_scores is None:
            return np.zeros(self._present.shape)
        return evidence(bank.class_scores, bank.photograph_scores, classes)

    def relevancies(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Relevancies float64 [Q, N] in [0, 1] of texts to the objects; errors as :meth:`gaps`."""
        relevancies: np.ndarray = sigmoid(rules.temperature * self.gaps(texts, rules))
        return relevancies

    def chosen(
        self, texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, rules: Rules
    ) -> np.ndarray:
        """Choose the objects of answers, bool [Q, N].

        Parameters
        ----------
        texts : sequence of str
        gaps : float64 [Q, N]
            Their gaps; -inf is what cannot be meant.
        areas : int64 [N]
            Pixels of each object in the view that is asked.
        rules : Rules
        """
        if rules.threshold is not None:
            above: np.ndarray = gaps > rules.least_gap
            return above
        best = gaps.max(1, where=areas > 0, initial=-np.inf, keepdims=True)
        chosen = near_best(gaps, best, rules.share)
        wholes, ranking = self.bank.wholes, getattr(self.encoder, "ranking", None)
        ranked = [k for k, text in enumerate(texts) if self._who(text) == "known"]
        if ranked and wholes and ranking and not unmeasured(self.encoder, rules):
            known = [texts[k] for k in ranked]
            chosen[ranked] = self.candidates(known, gaps[ranked], areas, rules).best(ranking)
        return chosen

    def candidates(
        self, texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, rules: Rules
    ) -> Candidates:
        """Describe what may be the answers to texts of known words; arguments as :meth:`chosen`."""
        assert self.bank.wholes is not None
        plain = self._scorer(self.phrases(rules), rules.absent).gaps(self.vectors(texts))
        plain = np.where(gaps > -np.inf, plain, -np.inf)
        evidence = np.stack([self.class_evidence(text)[: len(self.bank)] for text in texts])
        return self.bank.wholes.candidates(plain, evidence, areas, rules.share)

    def understood(self, text: str) -> Understood:
        """Read ``text``: what counts and what does not; InputError if nothing can use it."""
        who = self._who(text)
        if who == "known":
            return super().understood(text)
        try:
            also = super().understood(text)
            instead_of = "" if also.unknown else also.read_as
        except InputError:
            instead_of = ""
        word = normal(text)
        examples = self.taught.examples(word) if who == "taught" else 0
        return Understood(word, (), {}, who, examples, instead_of)

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that are left out; InputError as :meth:`understood`."""
        return self.understood(text).unknown

    def _who(self, text: str) -> str:
        """Name what answers: a name wins over a taught word, and that over the encoder."""
        if spelled(text) in self._called:
            return "named"
        return "taught" if text in self.taught else "known"

    def _make_scorer(self, phrases: tuple[str, ...], absent: str) -> Scorer:
        for phrase in phrases:
            if untold := super().understood(phrase).untold:
                raise InputError(f"canonical phrase {phrase!r}: {untold}")
        canonical = self.vectors(phrases)
        soft = getattr(self.encoder, "soft", SOFT)
        return Scorer(*self.bank.nodes, canonical, absent, self.bank.levels, soft)
