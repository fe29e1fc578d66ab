"""Answers to texts: the objects chosen by their scores, and the probability that they are right.

Objects are scored, not pixels; images are filled in by object id.

The probability is a logistic regression on four features of an answer. The score of the best object
says how well the text fits it, but some object fits best in every view. The features are:

- the *evidence* for the best object: its gap times the number of measurements that the text asks
  for, as a naive Bayes classifier sums log-odds. A gap is a mean, and a high mean of few
  measurements is more likely to be chance;
- how many standard deviations the answer's objects *stand out* from the other objects, less if
  the others are fewer: what is not in a scene is often answered with nearly all of it;
- the number of disconnected *parts* of the answer: objects that fit best by chance are scattered;
- if the noun is a class of the classifier, the highest log-probability of that class in any object
  of the scene (*named*). It is the best indicator of absent objects.

The coefficients belong to the encoder, since the scale of its cosines does.
``benches/language/answer_confidence.py`` fits them and evaluates them at held-out places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from slgaussian.io import short
from slgaussian.language import Encoder, Understood
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader, sigmoid
from slgaussian.language.wholes import Candidates, near_best

NEAR_BEST_POINT = 0.9
"""The point lies on the largest of the objects whose gap is at least this fraction of the best."""

STD_OFFSET = 0.02
"""Added to the standard deviation of the other objects, as two similar objects have almost none."""

TYPICAL_STAND_OUT = 2.1
"""Value of ``stands_out`` without other objects to compare with: the median of right masks."""

MIN_POINT_PROBABILITY = 0.1
"""Probability of the point being on the object below which the object is reported as absent. At
labelled places, with the classifier, where half of the queried objects are present: 14 % of present
objects are reported as absent, and 80 % of the objects reported as absent are."""


class Signs(NamedTuple):
    """Features of the logistic regression; see the module.

    ``parts`` is the logarithm of the number of parts, 0 for one part. ``named`` is 0 if the noun
    has no classes.
    """

    evidence: float
    stands_out: float
    parts: float
    named: float = 0.0


class Curve(NamedTuple):
    """Coefficients of the logistic regression on :class:`Signs`, and its intercept (``offset``)."""

    evidence: float
    stands_out: float
    parts: float
    named: float
    offset: float

    def __call__(self, signs: Signs) -> float:
        """Compute the probability, in (0, 1)."""
        at = sum(weight * sign for weight, sign in zip(self, signs, strict=False)) + self.offset
        return 1 / (1 + math.exp(-min(max(at, -50.0), 50.0)))


class Confidence(NamedTuple):
    """Probabilities in (0, 1) that an answer is right; see :class:`Calibration`."""

    mask: float
    point: float

    @property
    def verdict(self) -> str:
        """``found``, ``not sure`` (the mask is probably wrong) or ``not here``."""
        if self.point < MIN_POINT_PROBABILITY:
            return "not here"
        return "found" if self.mask >= 0.5 else "not sure"


class Calibration(NamedTuple):
    """Fitted coefficients of an encoder.

    Attributes:
        mask: Probability that the IoU of the mask with the object is above 0.5.
        point: Probability that the point lies on the object.
    """

    mask: Curve
    point: Curve

    def __call__(self, signs: Signs) -> Confidence:
        """Compute the probabilities that an answer with these :func:`signs` is right."""
        return Confidence(self.mask(signs), self.point(signs))


@dataclass(frozen=True, eq=False, kw_only=True)
class QueryResult:
    """The answer to a text in one image. Its images are computed on first access.

    Attributes:
        scores: float64 [N]. Relevancy of every object of the bank in [0, 1], visible or not.
        understood: The encoder's reading of the text.
        ids: int32 [N]. Ids of the objects of the bank.
        ranked: Rows in the bank of the visible objects that some view shows, best first.
        chosen: bool [N]. Objects that the rules select, visible or not.
        pointed: Rows of the candidates for the point, see :data:`NEAR_BEST_POINT`.
        image: The objects of the image.
        confidence: Probabilities that mask and point are right; None without a calibration, and for
            names.
        uncalibrated: Reason of a missing calibration, such as ``the encoder clip``; empty if none
            is missing.
    """

    text: str
    scores: np.ndarray
    understood: Understood
    ids: np.ndarray = field(repr=False)
    ranked: np.ndarray = field(repr=False)
    chosen: np.ndarray = field(repr=False)
    pointed: np.ndarray = field(repr=False)
    image: ObjectMap = field(repr=False)
    confidence: Confidence | None = None
    uncalibrated: str = ""

    def __repr__(self) -> str:
        ids = short([id_ for id_, _ in self.objects])
        summary = f"{self.verdict}, score {self.score:.3f}, objects {ids}"
        return f"{type(self).__name__}({self.text!r}: {summary})"

    @property
    def kind(self) -> str:
        """Source of the answer: ``known``, ``named``, ``taught`` and so on."""
        return self.understood.kind

    @property
    def unknown(self) -> tuple[str, ...]:
        """Words of the text that the encoder does not know and ignored."""
        return self.understood.unknown

    @property
    def score(self) -> float:
        """Relevancy of the best visible object, 0.5 if as good as a generic phrase; 0 if none."""
        return float(self.scores[self.ranked[0]]) if len(self.ranked) else 0.0

    @cached_property
    def objects(self) -> tuple[tuple[int, float], ...]:
        """The selected objects as (id, relevancy), best first; ties go to the lowest id."""
        rows = self.ranked[self.chosen[self.ranked]]
        return tuple((int(self.ids[i]), float(self.scores[i])) for i in rows)

    @cached_property
    def relevancy(self) -> np.ndarray:
        """float32 [H, W] in [0, 1]; 0 where there is no object."""
        return self.image.spread(self.scores.astype(np.float32))

    @cached_property
    def mask(self) -> np.ndarray:
        """bool [H, W]: the pixels of the selected objects."""
        return self.image.spread(self.chosen)

    @property
    def found(self) -> bool:
        """True if the :attr:`verdict` is ``found``."""
        return self.verdict == "found"

    @property
    def verdict(self) -> str:
        """``found``, ``not sure``, ``not here`` or ``cannot tell``; every output follows this.

        It is ``cannot tell`` for an unknown noun (:attr:`Understood.untold`), and otherwise follows
        :attr:`confidence`; without a confidence, ``found`` means that the mask is not empty. Mask
        and point are best guesses whatever the verdict.
        """
        if self.understood.untold:
            return "cannot tell"
        if not self.objects:
            return "not here"
        return "found" if self.confidence is None else self.confidence.verdict

    @property
    def shown(self) -> bool:
        """True if mask and point should be shown: the verdict is ``found`` or ``not sure``."""
        return self.verdict in ("found", "not sure")

    @property
    def summary(self) -> str:
        """The verdict and its probability in one line, for terminal, JSON, picture and viewer."""
        if self.understood.untold:
            return f"cannot tell: {self.understood.untold}"
        if not self.objects:
            reason = f"the best object scores {self.score:.3f}"
            return f"not here: {reason if len(self.ranked) else 'this view shows no object'}"
        if self.confidence is None:
            return f"found, uncalibrated for {self.uncalibrated}" if self.uncalibrated else "found"
        mask, point = self.confidence
        if self.verdict == "not here":
            return f"probably not here: {point:.2f} that the best object is it"
        summary = f"{mask:.2f} that the mask is right, {point:.2f} that the point is"
        return f"{self.verdict}: {summary}{self.understood.alone}"

    @cached_property
    def point(self) -> tuple[int, int] | None:
        """Column and row (x, y) of the most likely pixel of the object.

        It is the :func:`slgaussian.language.objectmap.central_point` of the largest of the selected
        objects that fit about as well as the best of them (:data:`NEAR_BEST_POINT`): small ones are
        more likely to fit by chance. If none is selected, all visible objects are considered; None
        without any.
        """
        if not len(self.ranked):
            return None
        return self.image.point(int(self.pointed[self.image.areas[self.pointed].argmax()]))


def ask(
    texts: Sequence[str],
    image: ObjectMap,
    reader: BankReader,
    rules: Rules,
    among: np.ndarray | None = None,
) -> list[QueryResult]:
    """Answer each text with the objects that an image shows.

    ``among`` bool [N], optional, excludes other objects of the bank from all scores.

    Raises:
        InputError: If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    if among is not None:
        gaps = np.where(among, gaps, -np.inf)
    chosen = choose(texts, gaps, image.areas, reader, rules)
    visible = np.flatnonzero(image.areas)
    uncalibrated = _missing_calibration(reader.encoder, rules)
    calibration = None if uncalibrated else reader.encoder.calibration
    answers, scores = [], sigmoid(rules.temperature * gaps)
    for text, gap, choice, relevancies in zip(texts, gaps, chosen, scores, strict=True):
        understood, confidence = reader.understood(text), None
        ranked = visible[np.argsort(-gap[visible], kind="stable")]
        ranked = ranked[gap[ranked] > -np.inf]
        pointed = ranked[choice[ranked]] if choice[ranked].any() else ranked
        best = gap[pointed].max(initial=-np.inf)
        named = understood.kind == "named"
        if calibration is not None and not named and len(ranked):
            parts, asks = image.parts(choice & (gap > -np.inf)), understood.measurements
            at = signs(gap[ranked], choice[ranked], asks, parts, understood.named)
            confidence = calibration(at)
        answers.append(
            QueryResult(
                text=text,
                scores=relevancies,
                understood=understood,
                ids=reader.bank.ids,
                ranked=ranked,
                chosen=choice,
                pointed=pointed[gap[pointed] >= min(NEAR_BEST_POINT * best, best)],
                image=image,
                confidence=confidence,
                uncalibrated="" if named else uncalibrated,
            )
        )
    return answers


def segment(texts: Sequence[str], image: ObjectMap, reader: BankReader, rules: Rules) -> np.ndarray:
    """Assign to every object the text with the highest relevancy, whatever the temperature.

    Returns:
        int32 [H, W]: k + 1 where ``texts[k]`` has the highest relevancy; ties go to the first text.
            0 without an object, or if no text has a relevancy above the threshold of ``rules``, by
            default 0.5.

    Raises:
        InputError: If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    winner = np.where(gaps.max(0) > rules.least_gap, gaps.argmax(0) + 1, 0)
    return image.spread(winner.astype(np.int32))


def choose(
    texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, reader: BankReader, rules: Rules
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
    ranking = None if _missing_calibration(reader.encoder, rules) else reader.encoder.ranking
    known = [k for k, source in enumerate(reader.sources(texts)) if source == "known"]
    if known and reader.bank.wholes and ranking:
        found = find_candidates([texts[k] for k in known], gaps[known], areas, reader, rules)
        chosen[known] = found.best(ranking)
    return chosen


def find_candidates(
    texts: Sequence[str], gaps: np.ndarray, areas: np.ndarray, reader: BankReader, rules: Rules
) -> Candidates:
    """Compute the candidate answers to texts of known words; arguments as :func:`choose`."""
    assert reader.bank.wholes is not None
    plain = np.where(gaps > -np.inf, reader.appearance_gaps(texts, rules), -np.inf)
    evidence = reader.class_evidence(texts)[:, : len(reader.bank)]
    return reader.bank.wholes.candidates(plain, evidence, areas, rules.share)


def _missing_calibration(encoder: Encoder, rules: Rules) -> str:
    """Name the setting without a calibration; empty if answers are calibrated."""
    if encoder.calibration is None:
        return f"the encoder {encoder.name}"
    return "" if rules.canonical is None else "canonical phrases of your own"


def signs(
    gaps: np.ndarray, selected: np.ndarray, measurements: int, parts: int, named: float = 0.0
) -> Signs:
    """Compute the features of an answer.

    ``stands_out`` is the mean gap of the selected objects minus that of the others, in standard
    deviations of the others; :data:`TYPICAL_STAND_OUT` with fewer than two others. For S selected
    objects and R < S - 1 others it is multiplied by (R + 1) / S.

    Args:
        gaps: float64 [M]. Gaps of the M > 0 visible objects that some photograph shows.
        selected: bool [M]. Objects of the answer; if none is, the best one is used.
        measurements: Number of measurements that the text asks for.
        parts: Number of connected parts of the selected objects; 0 counts as 1.
        named: See :class:`Signs`.
    """
    best = float(gaps.max())
    if not selected.any():
        selected = gaps == best
    rest, stands_out = gaps[~selected], TYPICAL_STAND_OUT
    if len(rest) >= 2:
        stands_out = float((gaps[selected].mean() - rest.mean()) / (rest.std() + STD_OFFSET))
    stands_out *= min(1.0, (len(rest) + 1) / int(selected.sum()))
    return Signs(best * measurements, stands_out, math.log(max(parts, 1)), named)
