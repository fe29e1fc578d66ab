"""Text queries on an image of object ids: relevancy, mask, point and segmentation.

Objects are scored, not pixels; images are filled in by object id.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from slgaussian.io import short
from slgaussian.language import Understood
from slgaussian.language.confidence import Confidence, signs
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.reader import BankReader
from slgaussian.language.relevancy import sigmoid
from slgaussian.language.rules import Rules, unmeasured
from slgaussian.language.wholes import MIN_PIXELS

NEAR_BEST_POINT = 0.9
"""The point lies on the largest of the objects whose gap is at least this fraction of the best."""


@dataclass(frozen=True, eq=False)
class QueryResult:
    """The answer to a text in one image. Its images are computed on first access.

    Attributes:
        scores: float64 [N]. Relevancy of every object of the bank in [0, 1], visible or not.
        understood: The encoder's reading of the text.
    """

    text: str
    scores: np.ndarray
    understood: Understood
    _ids: np.ndarray = field(repr=False)
    _seen: ObjectMap = field(repr=False)
    _ranked: np.ndarray = field(repr=False)
    """Rows in the bank of the visible objects that some view shows, best first."""
    _as_good: np.ndarray = field(repr=False)
    """Rows of the candidates for the point, see :data:`NEAR_BEST_POINT`."""
    _chosen: np.ndarray = field(repr=False)
    """bool [N]: objects that the rules select, visible or not."""
    confidence: Confidence | None = None
    """Probabilities that mask and point are right; None without a calibration, and for names."""
    uncalibrated: str = ""
    """Reason of a missing calibration, such as ``the encoder clip``; empty if none is missing."""

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
        return float(self.scores[self._ranked[0]]) if len(self._ranked) else 0.0

    @cached_property
    def objects(self) -> tuple[tuple[int, float], ...]:
        """The selected objects as (id, relevancy), best first; ties go to the lowest id."""
        rows = self._ranked[self._chosen[self._ranked]]
        return tuple((int(self._ids[i]), float(self.scores[i])) for i in rows)

    @cached_property
    def relevancy(self) -> np.ndarray:
        """float32 [H, W] in [0, 1]; 0 where there is no object."""
        return self._seen.spread(self.scores.astype(np.float32))

    @cached_property
    def mask(self) -> np.ndarray:
        """bool [H, W]: the pixels of the selected objects."""
        return self._seen.spread(self._chosen)

    @property
    def found(self) -> bool:
        """True if the :attr:`verdict` is ``found``."""
        return self.verdict == "found"

    @property
    def verdict(self) -> str:
        """``found``, ``not sure``, ``not here`` or ``cannot tell``; every output follows this.

        It is ``cannot tell`` for an unknown noun (:attr:`Understood.untold`), and otherwise follows
        :attr:`confidence`, see :class:`slgaussian.language.confidence.Confidence`; without a
        confidence, ``found`` means that the mask is not empty. Mask and point are best guesses
        whatever the verdict.
        """
        if self.understood.untold:
            return "cannot tell"
        if not self.mask.any():
            return "not here"
        return "found" if self.confidence is None else self.confidence.verdict

    @property
    def shown(self) -> bool:
        """True if mask and point should be shown: the verdict is ``found`` or ``not sure``."""
        return self.verdict in ("found", "not sure")

    @property
    def summary(self) -> str:
        """The verdict and its probability in one line, for terminal, JSON, picture and viewer.

        ``summary`` of ``viewer/page/words.js`` must give the same text.
        """
        if self.understood.untold:
            return f"cannot tell: {self.understood.untold}"
        if not self.mask.any():
            reason = f"the best object scores {self.score:.3f}"
            return f"not here: {reason if len(self._ranked) else 'this view shows no object'}"
        if self.confidence is None:
            return f"found, uncalibrated for {self.uncalibrated}" if self.uncalibrated else "found"
        mask, point = self.confidence
        if self.verdict == "not here":
            return f"probably not here: {point:.2f} that the best object is it"
        summary = f"{mask:.2f} that the mask is right, {point:.2f} that the point is"
        return f"{self.verdict}: {summary}{self.understood.alone}"

    @property
    def point(self) -> tuple[int, int] | None:
        """Column and row (x, y) of the most likely pixel of the object.

        It is the :func:`slgaussian.language.objectmap.central_point` of the largest of the selected
        objects that fit about as well as the best of them (:data:`NEAR_BEST_POINT`): small ones are
        more likely to fit by chance. If none is selected, all visible objects are considered; None
        without any.
        """
        if not len(self._ranked):
            return None
        return self._seen.point(int(self._as_good[self._seen.areas[self._as_good].argmax()]))


def ask(
    texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules
) -> list[QueryResult]:
    """Answer each text with the objects that an image shows.

    Raises:
        InputError: If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    chosen = reader.chosen(texts, gaps, seen.areas, rules)
    return [_answer(*each, seen, reader, rules) for each in zip(texts, gaps, chosen, strict=True)]


def _answer(
    text: str,
    gaps: np.ndarray,
    chosen: np.ndarray,
    seen: ObjectMap,
    reader: BankReader,
    rules: Rules,
) -> QueryResult:
    """Answer a text from its gaps float64 [N] (-inf: impossible) and the selected objects [N]."""
    calibration, uncalibrated = reader.encoder.calibration, unmeasured(reader.encoder, rules)
    visible = np.flatnonzero(seen.areas)
    ranked = visible[np.argsort(-gaps[visible], kind="stable")]
    ranked = ranked[gaps[ranked] > -np.inf]
    as_good = ranked[chosen[ranked]] if chosen[ranked].any() else ranked
    best = gaps[as_good].max(initial=-np.inf)
    as_good = as_good[gaps[as_good] >= min(NEAR_BEST_POINT * best, best)]
    scores = sigmoid(rules.temperature * gaps)
    read, probabilities = reader.understood(text), None
    if read.kind == "named":
        calibration, uncalibrated = None, ""
    if calibration is not None and not uncalibrated and len(ranked):
        parts = seen.parts(chosen & (gaps > -np.inf))
        at = signs(gaps[ranked], chosen[ranked], read.measurements, parts, read.named)
        probabilities = calibration(at)
    selection = ranked, as_good, chosen, probabilities, uncalibrated
    return QueryResult(text, scores, read, reader.bank.ids, seen, *selection)


def find(
    text: str, reader: BankReader, rules: Rules, among: np.ndarray
) -> tuple[tuple[int, float], ...]:
    """Find the objects of a text independently of any view: (id, relevancy), best first.

    Only the objects ``among`` bool [N] of the bank are considered. InputError as :func:`ask`.
    """
    gaps = np.where(among, reader.gaps([text], rules)[0], -np.inf)
    everywhere = np.where(among, MIN_PIXELS, 0)
    matching = np.flatnonzero(reader.chosen([text], gaps[None], everywhere, rules)[0] & among)
    scores = sigmoid(rules.temperature * gaps)
    ranked = matching[np.argsort(-gaps[matching], kind="stable")]
    return tuple((int(reader.bank.ids[i]), float(scores[i])) for i in ranked)


def segment(texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules) -> np.ndarray:
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
    return seen.spread(winner.astype(np.int32))
