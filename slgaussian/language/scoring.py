"""Scores of a bank's objects for texts: section 3.3 of the paper, computed without overflow.

The paper's  max_j min_i  exp(T L_j.q) / (exp(T L_j.q) + exp(T L_j.c_i))  is a sigmoid of T times

    gap = max_j ( L_j.q - max_i L_j.c_i )

over the views j that show the object and the canonical phrases c_i, because the sigmoid is
increasing. This avoids overflow, and the gap orders objects in the same way at every temperature,
even where the sigmoid saturates. T = 1 is the paper's formula; T = 10, the default, is that of the
published code of LERF and LangSplat.

If groups of objects are known, a text may describe a group: a sofa is segmented into cushions and
arms, none of which looks like a sofa. Then j runs over the object and the groups that contain it,
in every view, and a soft maximum of the leads replaces the maximum,

    gap = sum_j w_j lead_j / sum_j w_j,   w_j = exp(lead_j / s),

so that one feature that fits by chance counts less than several that agree. s is the encoder's
``soft``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from slgaussian.errors import InputError
from slgaussian.language import Encoder, Understood
from slgaussian.language.bank import MemoryBank
from slgaussian.language.classifier import evidence, log_probability
from slgaussian.language.rules import Rules
from slgaussian.language.taught import TaughtWords, normalize, unify_spelling

CLASS_LEAD = 0.1
"""Largest lead in cosine from class evidence, for a text that is a noun alone. Fitted, with the
next two constants, on labelled photographs; leave-one-place-out fits give nearly the same."""

CLASS_SCALE = 3.0
"""Class evidence, in nats, that gives three quarters of the largest lead."""

DESCRIPTION_WEIGHT = 0.5
"""Weight of each word that describes the noun, relative to the noun: class evidence counts less for
a described object."""

NEUTRAL_LOG_PROBABILITY = -3.0
"""Highest log-probability of a noun's classes in any object at which it is neutral evidence."""

NAME_GAP = 10.0
"""Gap of objects with the name that is asked for; all others have its negative. It is far larger
than cosines, so that relevancies are 1 or 0 at all usual temperatures."""

CACHE_SIZE = 4096
"""Number of texts whose vectors a reader caches."""

MAX_EXPONENT = math.log(np.finfo(np.float64).max)
"""Largest finite argument of exp."""


class Scorer:
    """Scores vectors of texts against a fixed set of objects.

    Args:
        features: float [M, V, C]. Unit vectors of M objects in V views; rows of absent views are
            ignored. With ``levels``, of objects and groups.
        present: bool [M, V]. True where the view shows the object.
        canonical: float [K, C]. Unit vectors of the K > 0 phrases that every query competes with.
        absent: One of :data:`slgaussian.language.rules.ABSENT_TREATMENTS`.
        levels: int [L, N], optional. For each of the N objects, which are the first rows, the row
            of its group at L levels, or its own row. By default all rows are objects.
        soft: Temperature of the soft maximum, positive; used only with groups.

    Attributes:
        looks: float64 [P, C]. The present vectors, in order of rows and views, normalised in
            float64, so that features rounded to half precision give true cosines.
    """

    def __init__(
        self,
        features: np.ndarray,
        present: np.ndarray,
        canonical: np.ndarray,
        absent: str = "skip",
        levels: np.ndarray | None = None,
        soft: float = 0.05,
    ) -> None:
        self._present = present
        self.looks = _normalize(features[present])
        self._rival = self._cosines(canonical).max(0)
        self._unseen = -np.inf if absent == "skip" else 0.0
        self._soft = soft
        self._rows = None
        if levels is not None:
            self._rows = np.concatenate([np.arange(levels.shape[1])[None], levels])

    def gaps(self, queries: np.ndarray, extra_leads: np.ndarray | float = 0.0) -> np.ndarray:
        """Compute the gaps of the module's formula, float64 [Q, N]; -inf if no view shows it.

        ``queries`` float [Q, C] are unit vectors of texts; ``extra_leads`` [Q, P] are added to the
        leads.
        """
        return self.combine(self._cosines(queries) - self._rival + extra_leads)

    def combine(self, leads: np.ndarray) -> np.ndarray:
        """Combine leads float64 [Q, P], one per text and present vector, to gaps [Q, N]."""
        gaps = np.full((len(leads), *self._present.shape), self._unseen)
        gaps[:, self._present] = leads
        if self._rows is None:
            return gaps.max(2, initial=-np.inf)
        nodes = gaps[:, self._rows.T].reshape(len(leads), self._rows.shape[1], -1)
        return _soft_maximum(nodes, self._soft)

    def _cosines(self, texts: np.ndarray) -> np.ndarray:
        # Not BLAS, whose last digit depends on threads and position: equal objects must tie.
        return np.einsum("tc,lc->tl", _normalize(texts), self.looks)


def _soft_maximum(leads: np.ndarray, soft: float) -> np.ndarray:
    """Compute the soft maximum of leads [Q, N, J] over the last axis; -inf if all are -inf."""
    top = leads.max(2, initial=-np.inf, keepdims=True)
    finite = leads > -np.inf
    above = np.where(finite, leads, 0) - np.where(finite.any(2, keepdims=True), top, 0)
    weights = np.where(finite, np.exp(above / soft), 0)
    # Average the deviation from the maximum, so that the result is exact for equal leads.
    deviation = (weights * above).sum(2) / np.maximum(weights.sum(2), 1)
    return top[..., 0] + deviation


def sigmoid(x: np.ndarray) -> np.ndarray:
    """Compute ``1 / (1 + exp(-x))``, float64 in the shape of ``x``.

    Uses the exponential of the C library (as SciPy does): the last digit of NumPy's depends on the
    CPU.
    """
    values = [1 / (1 + math.exp(-v)) if -v < MAX_EXPONENT else 0.0 for v in np.ravel(x).tolist()]
    return np.array(values, np.float64).reshape(np.shape(x))


def _normalize(vectors: np.ndarray) -> np.ndarray:
    """Normalise rows, whose length is nearly 1, in float64."""
    vectors = vectors.astype(np.float64)
    return vectors / np.sqrt(np.einsum("lc,lc->l", vectors, vectors))[:, None]


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
        self._taught = taught or TaughtWords()
        self._named: dict[str, list[int]] = {}
        for id_, name in (names or {}).items():
            self._named.setdefault(unify_spelling(name), []).append(id_)
        taught_by_spelling = dict.fromkeys(self._taught.lessons, "taught")
        self._sources = taught_by_spelling | dict.fromkeys(self._named, "named")
        self._scorer = lru_cache(4)(self._make_scorer)

    def gaps(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Compute the relevancy gaps float64 [Q, N] of texts to the objects of the bank.

        Raises:
            InputError: If there is no text, or the encoder cannot use one.
        """
        _check_list(texts)
        scorer = self._scorer(self.phrases(rules), rules.absent)
        gaps, known = np.empty((len(texts), len(self.bank))), []
        for k, (text, source) in enumerate(zip(texts, self.sources(texts), strict=True)):
            match source:
                case "named":
                    named = np.isin(self.bank.ids, self._named[unify_spelling(text)])
                    gaps[k] = np.where(named, NAME_GAP, -NAME_GAP)
                case "taught":
                    gaps[k] = scorer.combine(self._taught.leads(text, scorer.looks)[None])[0]
                case _:
                    known.append(k)
        if known:
            encoded = [texts[k] for k in known]
            gaps[known] = scorer.gaps(self.vectors(encoded), self._class_leads(encoded))
        return gaps

    def appearance_gaps(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Compute the gaps float64 [Q, N] of texts without class evidence; errors as `gaps`."""
        return self._scorer(self.phrases(rules), rules.absent).gaps(self.vectors(texts))

    def relevancies(self, texts: Sequence[str], rules: Rules) -> np.ndarray:
        """Compute the relevancies float64 [Q, N] in [0, 1] of texts; errors as :meth:`gaps`."""
        return sigmoid(rules.temperature * self.gaps(texts, rules))

    def class_evidence(self, texts: Sequence[str]) -> np.ndarray:
        """Compute the evidence for nouns' classes in ``bank.nodes``, float64 [Q, M, V], in nats.

        See :func:`slgaussian.language.classifier.evidence`; zeros if a noun has no classes or
        nothing was classified. InputError if a text cannot be used.
        """
        bank, found = self.bank, np.zeros((len(texts), *self._present.shape))
        if bank.class_scores is not None and bank.photograph_scores is not None:
            for k, text in enumerate(texts):
                if classes := self._read(text)[1].classes:
                    found[k] = evidence(bank.class_scores, bank.photograph_scores, classes)
        return found

    def sources(self, texts: Sequence[str]) -> list[str]:
        """Return what answers each: ``named``, else ``taught``, else ``known``, by the encoder."""
        if not self._sources:
            return ["known"] * len(texts)
        return [self._sources.get(unify_spelling(text), "known") for text in texts]

    def understood(self, text: str) -> Understood:
        """Return the reading of ``text``; InputError if neither encoder nor examples can use it."""
        (source,) = self.sources([text])
        if source == "known":
            return super().understood(text)
        try:
            read = super().understood(text)
            instead_of = "" if read.unknown else read.read_as
        except InputError:
            instead_of = ""
        word = normalize(text)
        examples = self._taught.examples(word) if source == "taught" else 0
        return Understood(word, (), {}, source, examples, instead_of)

    def _encode(self, text: str) -> tuple[np.ndarray, Understood]:
        vector, read = super()._encode(text)
        if read.classes and self.bank.class_scores is not None and self.bank.present.any():
            objects = self.bank.class_scores[: len(self.bank)][self.bank.present]
            likeliest = float(log_probability(objects, read.classes).max())
            read = replace(read, named=likeliest - NEUTRAL_LOG_PROBABILITY)
        return vector, read

    def _class_leads(self, texts: Sequence[str]) -> np.ndarray:
        """Compute the leads of texts by class evidence, float64 [Q, P]; zero without classes."""
        describing = np.array([self._read(text)[1].describing for text in texts])[:, None]
        strength = CLASS_LEAD / (1 + DESCRIPTION_WEIGHT * describing)
        return strength * np.tanh(self.class_evidence(texts)[:, self._present] / CLASS_SCALE)

    def _make_scorer(self, phrases: tuple[str, ...], absent: str) -> Scorer:
        for phrase in phrases:
            if untold := self._read(phrase)[1].untold:
                raise InputError(f"canonical phrase {phrase!r}: {untold}")
        return Scorer(
            *self.bank.nodes, self.vectors(phrases), absent, self.bank.levels, self.encoder.soft
        )


def _check_list(texts: Sequence[str]) -> None:
    if isinstance(texts, str) or not len(texts):
        problem = "one text" if isinstance(texts, str) else "no text"
        raise InputError(f"query: found {problem}, expected a list of at least one")
