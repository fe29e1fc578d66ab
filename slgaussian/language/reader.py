"""Readers of texts: an encoder's reading of a text, and the gaps of a bank's objects to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language import Encoder, Understood
from slgaussian.language.bank import MemoryBank
from slgaussian.language.classifier import evidence, log_probability
from slgaussian.language.confidence import NEUTRAL_LOG_PROBABILITY
from slgaussian.language.relevancy import SOFT_TEMPERATURE, Scorer, sigmoid
from slgaussian.language.rules import Rules, unmeasured
from slgaussian.language.taught import TaughtWords, normal, spelled
from slgaussian.language.wholes import Candidates, near_best

CLASS_LEAD = 0.1
"""Largest lead in cosine from class evidence, for a text that is a noun alone. Fitted, with the
next two constants, on labelled photographs; leave-one-place-out fits give nearly the same."""

CLASS_SCALE = 3.0
"""Class evidence, in nats, that gives three quarters of the largest lead."""

DESCRIPTION_WEIGHT = 0.5
"""Weight of each word that describes the noun, relative to the noun: class evidence counts less for
a described object."""

NAME_GAP = 10.0
"""Gap of objects with the name that is asked for; all others have its negative. It is far larger
than cosines, so that relevancies are 1 or 0 at all usual temperatures."""

CACHE_SIZE = 4096
"""Number of texts whose vectors a reader caches."""


class TextReader:
    """An encoder with a cache of texts, which are encoded one by one."""

    by_class = False
    """True if a classifier has classified the objects."""

    def __init__(self, encoder: Encoder) -> None:
        self.encoder = encoder
        self._read = lru_cache(CACHE_SIZE)(self._encode)

    def vectors(self, texts: Sequence[str]) -> np.ndarray:
        """Encode texts as unit vectors float32 [Q, C].

        Raises:
            InputError: If there is no text, or the encoder cannot use one.
        """
        _check_list(texts)
        return np.stack([self._read(text)[0] for text in texts])

    def phrases(self, rules: Rules) -> tuple[str, ...]:
        """Return the canonical phrases of ``rules`` or, by default, of the encoder."""
        return rules.phrases or tuple(self.encoder.canonical)

    def understood(self, text: str) -> Understood:
        """Return the reading of ``text``; InputError if the encoder cannot use it."""
        return self._read(text)[1]

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """Return the ignored unknown words of ``text``; InputError as :meth:`understood`."""
        return self.understood(text).unknown

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        read = self.encoder.understand(text, self.by_class)
        # A text without a known word is encoded as a generic phrase.
        phrase = text if read.read_as or not read.untold else self.encoder.canonical[0]
        return self.encoder.encode_text([phrase])[0], read


class BankReader(TextReader):
    """Scores texts against a memory bank, with the encoder that built it.

    Scores of the canonical phrases are cached. A text that equals one of the ``names`` {id: name}
    matches exactly the objects with this name; one of the ``taught`` words is answered by its
    examples.
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
        self.taught = taught or TaughtWords()
        self._called: dict[str, list[int]] = {}
        for id_, name in (names or {}).items():
            self._called.setdefault(spelled(name), []).append(id_)
        self._scorer = lru_cache(4)(self._make_scorer)

    def gaps(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Compute the relevancy gaps float64 [Q, N] of texts to the objects of the bank.

        Raises:
            InputError: If there is no text, or the encoder cannot use one.
        """
        _check_list(texts)
        scorer = self._scorer(self.phrases(rules), rules.absent)
        gaps = np.empty((len(texts), len(self.bank)))
        known = []
        for k, text in enumerate(texts):
            who = self._answer_kind(text)
            if who == "named":
                has_name = np.isin(self.bank.ids, self._called[spelled(text)])
                gaps[k] = np.where(has_name, NAME_GAP, -NAME_GAP)
            elif who == "taught":
                gaps[k] = scorer.combined(self.taught.leads(text, scorer.looks)[None])[0]
            else:
                known.append(k)
        if known:
            encoded = [texts[k] for k in known]
            leads = np.stack([self._class_leads(text) for text in encoded])
            gaps[known] = scorer.gaps(self.vectors(encoded), leads)
        return gaps

    def _class_leads(self, text: str) -> np.ndarray:
        """Compute the leads of a text from class evidence, float64 [P]; zero without classes."""
        strength = CLASS_LEAD / (1 + DESCRIPTION_WEIGHT * super().understood(text).describing)
        leads = strength * np.tanh(self.class_evidence(text) / CLASS_SCALE)
        return np.asarray(leads[self._present])

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        vector, read = super()._encode(text)
        if read.classes and self.bank.class_scores is not None and self.bank.present.any():
            objects = self.bank.class_scores[: len(self.bank)][self.bank.present]
            likeliest = float(log_probability(objects, read.classes).max())
            read = replace(read, named=likeliest - NEUTRAL_LOG_PROBABILITY)
        return vector, read

    def class_evidence(self, text: str) -> np.ndarray:
        """Compute the evidence for the noun's classes in ``bank.nodes``, float64 [M, V], in nats.

        See :func:`slgaussian.language.classifier.evidence`; zeros if the noun has no classes or
        nothing was classified. InputError if the text cannot be used.
        """
        bank, classes = self.bank, super().understood(text).classes
        if not classes or bank.class_scores is None or bank.photograph_scores is None:
            return np.zeros(self._present.shape)
        return evidence(bank.class_scores, bank.photograph_scores, classes)

    def relevancies(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Compute the relevancies float64 [Q, N] in [0, 1] of texts; errors as :meth:`gaps`."""
        return sigmoid(rules.temperature * self.gaps(texts, rules))

    def chosen(
        self, texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, rules: Rules
    ) -> np.ndarray:
        """Select the objects of each answer, bool [Q, N].

        Args:
            texts: sequence of str
            gaps: float64 [Q, N]. Gaps of the texts; -inf excludes an object.
            areas: int64 [N]. Pixels of each object in the queried view.
        """
        if rules.threshold is not None:
            above: np.ndarray = gaps > rules.least_gap
            return above
        best = gaps.max(1, where=areas > 0, initial=-np.inf, keepdims=True)
        chosen = near_best(gaps, best, rules.share)
        wholes, ranking = self.bank.wholes, getattr(self.encoder, "ranking", None)
        ranked = [k for k, text in enumerate(texts) if self._answer_kind(text) == "known"]
        if ranked and wholes and ranking and not unmeasured(self.encoder, rules):
            ranked_texts = [texts[k] for k in ranked]
            chosen[ranked] = self.candidates(ranked_texts, gaps[ranked], areas, rules).best(ranking)
        return chosen

    def candidates(
        self, texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, rules: Rules
    ) -> Candidates:
        """Compute the candidate answers to texts of known words; arguments as :meth:`chosen`."""
        assert self.bank.wholes is not None
        plain = self._scorer(self.phrases(rules), rules.absent).gaps(self.vectors(texts))
        plain = np.where(gaps > -np.inf, plain, -np.inf)
        evidence = np.stack([self.class_evidence(text)[: len(self.bank)] for text in texts])
        return self.bank.wholes.candidates(plain, evidence, areas, rules.share)

    def understood(self, text: str) -> Understood:
        """Return the reading of ``text``; InputError if neither encoder nor examples can use it."""
        who = self._answer_kind(text)
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

    def _answer_kind(self, text: str) -> str:
        """Return the kind of answer: names take precedence over taught words, then the encoder."""
        if spelled(text) in self._called:
            return "named"
        return "taught" if text in self.taught else "known"

    def _make_scorer(self, phrases: tuple[str, ...], absent: str) -> Scorer:
        for phrase in phrases:
            if untold := super().understood(phrase).untold:
                raise InputError(f"canonical phrase {phrase!r}: {untold}")
        canonical = self.vectors(phrases)
        soft = getattr(self.encoder, "soft", SOFT_TEMPERATURE)
        return Scorer(*self.bank.nodes, canonical, absent, self.bank.levels, soft)


def _check_list(texts: Sequence[str]) -> None:
    if isinstance(texts, str) or not len(texts):
        problem = "one text" if isinstance(texts, str) else "no text"
        raise InputError(f"query: found {problem}, expected a list of at least one")
