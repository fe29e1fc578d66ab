"""Ask an image of object ids for words: find, locate and segment.

Every answer is one number an object, spread over the image by id; no pixel is scored on its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from slgaussian.io import short
from slgaussian.language.confidence import Confidence, confidence, signs
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.reader import BankReader, Understood
from slgaussian.language.relevancy import sigmoid
from slgaussian.language.rules import Rules, unmeasured
from slgaussian.language.wholes import LEAST_PIXELS

AS_GOOD = 0.9
"""The largest of the objects whose gap reaches this fraction of the best gap is pointed at."""


@dataclass(frozen=True, eq=False)
class QueryResult:
    """The answer to a text in one image. Pictures are drawn when they are first looked at.

    Attributes
    ----------
    text : str
    scores : float64 [N]
        Relevancy of every object of the bank in [0, 1], whether the image shows it or not.
    understood : Understood
        Which words of the text count.
    """

    text: str
    scores: np.ndarray
    understood: Understood
    _ids: np.ndarray = field(repr=False)
    _seen: ObjectMap = field(repr=False)
    _ranked: np.ndarray = field(repr=False)
    """Places in the bank of the visible objects that some view holds, best first."""
    _as_good: np.ndarray = field(repr=False)
    """Places of those that the point may be on: about as good as the best of the answer."""
    _chosen: np.ndarray = field(repr=False)
    """bool [N]: what the rules select, visible or not."""
    confidence: Confidence | None = None
    """How likely mask and point are right; None where that was not measured: of an encoder without
    a calibration, or with canonical phrases of one's own. And of a name, of which nothing is to be
    doubted."""
    uncalibrated: str = ""
    """For what that was not measured, such as ``the encoder clip``; empty where it was, or where
    nothing is to be doubted."""

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
        """Words of the text that the encoder does not know and left out."""
        return self.understood.unknown

    @property
    def score(self) -> float:
        """Relevancy of the best visible object; 0.5 is "as good as any phrase". 0 without one."""
        return float(self.scores[self._ranked[0]]) if len(self._ranked) else 0.0

    @cached_property
    def objects(self) -> tuple[tuple[int, float], ...]:
        """The selected objects as (id, relevancy), best first; of equal ones the lowest id."""
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
        """``found``, ``not sure``, ``not here`` or ``cannot tell``: all that is told goes by this.

        Nothing can be told of a noun that nobody knows (:attr:`Understood.untold`). Else by
        :attr:`confidence`, see :class:`slgaussian.language.confidence.Confidence`; without it what
        selects anything is found. Mask and point are given whatever it says, as best guesses.
        """
        if self.understood.untold:
            return "cannot tell"
        if not self.mask.any():
            return "not here"
        return "found" if self.confidence is None else self.confidence.verdict

    @property
    def shown(self) -> bool:
        """True if mask and point are to be shown: the verdict is ``found`` or ``not sure``."""
        return self.verdict in ("found", "not sure")

    @property
    def summary(self) -> str:
        """The verdict and how likely it is, in one line: of terminal, JSON, picture and viewer.

        A page says the same (``summary`` of ``viewer/page/words.js``).
        """
        if self.understood.untold:
            return f"cannot tell: {self.understood.untold}"
        if not self.mask.any():
            why = f"the best object scores {self.score:.3f}"
            return f"not here: {why if len(self._ranked) else 'this view shows no object'}"
        if self.confidence is None:
            return f"found, uncalibrated for {self.uncalibrated}" if self.uncalibrated else "found"
        mask, point = self.confidence.mask, self.confidence.point
        if self.verdict == "not here":
            return f"probably not here: {point:.2f} that the best object is it"
        alone = self.understood.alone
        sure = f"{mask:.2f} that the mask is right, {point:.2f} that the point is"
        return f"{self.verdict}: {sure}{alone}"

    @property
    def point(self) -> tuple[int, int] | None:
        """Column and row (x, y) of the pixel that is the best guess of where the object is.

        Of the selected objects that fit about as well as the best of them does (:data:`AS_GOOD`),
        the one that the image shows most of: a sliver fits by chance more easily. The middle of
        where that one is thickest; see :func:`slgaussian.language.locate.central_point`. Given even
        if no object was good enough to be selected; None if the image shows none at all.
        """
        if not len(self._ranked):
            return None
        return self._seen.point(int(self._as_good[self._seen.areas[self._as_good].argmax()]))


def ask(
    texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules
) -> list[QueryResult]:
    """Find the objects that each text describes, among those that an image shows.

    Raises
    ------
    InputError
        If there is no text, or the encoder cannot use one.
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
    """Answer a text by its gaps float64 [N], -inf is what cannot be meant, and the chosen [N]."""
    calibration = reader.encoder.calibration
    doubt = unmeasured(reader.encoder, rules)
    visible = np.flatnonzero(seen.areas)
    ranked = visible[np.argsort(-gaps[visible], kind="stable")]
    ranked = ranked[gaps[ranked] > -np.inf]
    as_good = ranked[chosen[ranked]] if chosen[ranked].any() else ranked
    best = gaps[as_good].max(initial=-np.inf)
    as_good = as_good[gaps[as_good] >= min(AS_GOOD * best, best)]
    scores = sigmoid(rules.temperature * gaps)
    read, sure = reader.understood(text), None
    why = "" if read.kind == "named" else doubt
    if calibration is not None and not doubt and len(ranked) and read.kind != "named":
        parts = seen.parts(chosen & (gaps > -np.inf))
        at = signs(gaps[ranked], chosen[ranked], read.measurements, parts, read.named)
        sure = confidence(calibration, at)
    selection = ranked, as_good, chosen, sure, why
    return QueryResult(text, scores, read, reader.bank.ids, seen, *selection)


def find(
    text: str, reader: BankReader, rules: Rules, among: np.ndarray
) -> tuple[tuple[int, float], ...]:
    """The objects that a text describes, whatever the view: (id, relevancy), best first.

    ``among`` bool [N] are the objects of the bank that may be found. InputError as :func:`ask`.
    """
    gaps = np.where(among, reader.gaps([text], rules)[0], -np.inf)
    everywhere = np.where(among, LEAST_PIXELS, 0)
    matching = np.flatnonzero(reader.chosen([text], gaps[None], everywhere, rules)[0] & among)
    scores = sigmoid(rules.temperature * gaps)
    ranked = matching[np.argsort(-gaps[matching], kind="stable")]
    return tuple((int(reader.bank.ids[i]), float(scores[i])) for i in ranked)


def segment(texts: Sequence[str], seen: ObjectMap, reader: BankReader, rules: Rules) -> np.ndarray:
    """Give every object the text that describes it best; the temperature cannot change which.

    Returns
    -------
    int32 [H, W]
        k + 1 where ``texts[k]`` has the highest relevancy; ties go to the first text. 0 where there
        is no object, or none of the texts has a relevancy above the threshold of ``rules``, 0.5 if
        that is left out.

    Raises
    ------
    InputError
        If there is no text, or the encoder cannot use one.
    """
    gaps = reader.gaps(texts, rules)
    winner = np.where(gaps.max(0) > rules.least_gap, gaps.argmax(0) + 1, 0)
    return seen.spread(winner.astype(np.int32))
