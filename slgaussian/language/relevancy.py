"""The relevancy of an object to a text: section 3.3 of the paper, computed without overflow.

The paper's  max_j min_i  exp(T L_j.q) / (exp(T L_j.q) + exp(T L_j.c_i))  is a sigmoid of T times

    gap = max_j ( L_j.q - max_i L_j.c_i )

over the views j that hold the object and the canonical phrases c_i, because the sigmoid is
increasing. No exponential is taken of anything that can overflow, and the gap orders objects the
same way at every temperature, even where the sigmoid has saturated. T = 1 is the formula as
printed; T = 10, the default, is what the field's published code uses.

Where it is known what objects are part of, a text may mean the whole: of a sofa, cut up into
cushions and arms, no piece looks like one. Then j runs over the object itself and the groups that
hold it, in every view, and the greatest lead gives way to a soft one,

    gap = sum_j w_j lead_j / sum_j w_j,   w_j = exp(lead_j / s):

one look that fits by chance counts less than several that agree. s is 0.05, or what suits the
cosines of an encoder (its ``soft``).
"""

from __future__ import annotations

import math

import numpy as np

from slgaussian.errors import InputError, did_you_mean

UNIT_TOLERANCE = 1e-3
"""Largest allowed | |L| - 1 |. Rounding to half precision moves a length by at most 2^-11, half of
that; features that were never normalised do not pass."""

SOFT = 0.05
"""How much greater one lead in cosine is than another if it counts e times as much, where there
are groups, if the encoder says nothing else. From 0.02 to 0.1 the answers are about as good."""

LOG_MOST = math.log(np.finfo(np.float64).max)
"""Exponentials of more than this are infinite."""

ABSENT = ("skip", "zero")
"""What a view says about an object that it does not hold. ``skip``: nothing. ``zero``: what the
paper's zero vector says, which is gap 0 and so relevancy 0.5 to every text."""


class Scorer:
    """Scores texts against the same objects again and again.

    All that no text changes is worked out once: checks, lengths, and how well the best canonical
    phrase fits.

    Parameters
    ----------
    features : float [M, V, C]
        Unit vectors of M objects in V views; rows of absent views are ignored. With ``levels``, of
        objects and groups.
    present : bool [M, V]
        Which views hold the object.
    canonical : float [K, C]
        Unit vectors of the phrases that every query competes with, K at least 1.
    absent : str
        One of :data:`ABSENT`.
    levels : int [L, N], optional
        Of the first N rows, the objects, the row of the group that holds each at L levels, or its
        own. Without, all rows are objects and there are no groups.
    soft : float
        How much greater one lead is than another if it counts e times as much, where there are
        groups; positive.

    Attributes
    ----------
    looks : float64 [P, C]
        The used vectors, of the present rows and views in order, with a length of exactly 1.

    Raises
    ------
    InputError
        If shapes disagree, or a used vector is zero, holds NaN or is no unit vector by more than
        :data:`UNIT_TOLERANCE`. Within it, lengths are made exactly 1 first, so that features
        rounded to half precision give true cosines.
    """

    def __init__(
        self,
        features: np.ndarray,
        present: np.ndarray,
        canonical: np.ndarray,
        absent: str = "skip",
        levels: np.ndarray | None = None,
        soft: float = SOFT,
    ) -> None:
        if features.ndim != 3 or present.shape != features.shape[:2]:
            raise InputError(
                f"relevancy: found features {features.shape} and present {present.shape}, expected "
                "[N, V, C] and [N, V]"
            )
        if absent not in ABSENT:
            raise InputError(
                f"relevancy: absent is {absent!r}, expected one of {', '.join(ABSENT)}"
                f"{did_you_mean(absent, ABSENT)}"
            )
        self._width = features.shape[2]
        self._present = present
        self.looks = _unit_vectors(features[present], "features")
        self._rival = self._cosines(canonical, "canonical").max(0)
        self._unseen = -np.inf if absent == "skip" else 0.0
        self._soft = soft
        self._rows = None
        if levels is not None:
            self._rows = np.concatenate([np.arange(levels.shape[1])[None], levels])

    def gaps(self, queries: np.ndarray, extra_leads: np.ndarray | float = 0.0) -> np.ndarray:
        """The gap of the module's formula, float64 [Q, N]; -inf for an object that no view holds.

        ``queries`` float [Q, C] are unit vectors of texts; ``more`` [Q, P] is added to the leads of
        the looks. Errors as in the class.
        """
        return self.combined(self._cosines(queries, "queries") - self._rival + extra_leads)

    def combined(self, leads: np.ndarray) -> np.ndarray:
        """The gaps of :meth:`gaps` of leads float64 [Q, P], one a look and text, however made."""
        gaps = np.full((len(leads), *self._present.shape), self._unseen)
        gaps[:, self._present] = leads
        if self._rows is None:
            return gaps.max(2, initial=-np.inf)
        nodes = gaps[:, self._rows.T].reshape(len(leads), self._rows.shape[1], -1)
        return _soft_greatest(nodes, self._soft)

    def _cosines(self, texts: np.ndarray, name: str) -> np.ndarray:
        if texts.ndim != 2 or texts.shape[1] != self._width or len(texts) == 0:
            raise InputError(
                f"relevancy: {name} are {texts.shape}, expected [at least 1, {self._width}]; "
                "texts and regions must come from the same encoder"
            )
        # No BLAS product: its last digit depends on threads and place, and equal objects must tie.
        return np.einsum("tc,lc->tl", _unit_vectors(texts, name), self.looks)


def _soft_greatest(leads: np.ndarray, soft: float) -> np.ndarray:
    """The soft greatest of leads [Q, N, J], the last axis: [Q, N], -inf where all are -inf."""
    top = leads.max(2, initial=-np.inf, keepdims=True)
    known = leads > -np.inf
    above = np.where(known, leads, 0) - np.where(known.any(2, keepdims=True), top, 0)
    weights = np.where(known, np.exp(above / soft), 0)
    # The deviation from the greatest is averaged, so that equal leads give themselves exactly.
    deviation = (weights * above).sum(2) / np.maximum(weights.sum(2), 1)
    return top[..., 0] + deviation


def relevancy(
    features: np.ndarray,
    present: np.ndarray,
    queries: np.ndarray,
    canonical: np.ndarray,
    temperature: float = 10.0,
    absent: str = "skip",
) -> np.ndarray:
    """Relevancy of every object to every query.

    Parameters
    ----------
    features, present, canonical, absent
        See :class:`Scorer`.
    queries : float [Q, C]
        Unit vectors of the texts.
    temperature : float
        Multiplies the cosines; positive.

    Returns
    -------
    float64 [Q, N]
        In [0, 1]. 0.5 says that the text fits the object as well as the best canonical phrase does;
        exactly 0 is an object that no view holds.

    Raises
    ------
    InputError
        As :class:`Scorer`, and if the temperature is not positive.
    """
    check_temperature(temperature)
    return sigmoid(temperature * Scorer(features, present, canonical, absent).gaps(queries))


def sigmoid(x: np.ndarray) -> np.ndarray:
    """``1 / (1 + exp(-x))``, float64 in the shape of ``x``.

    By the C library's exponential, number by number: they are a few an object and a text. NumPy's
    own differs in the last digit from processor to processor; SciPy's is this one.
    """
    values = [1 / (1 + math.exp(-v)) if -v < LOG_MOST else 0.0 for v in np.ravel(x).tolist()]
    return np.array(values, np.float64).reshape(np.shape(x))


def check_temperature(temperature: float) -> None:
    """Raise InputError unless ``temperature`` is a positive number."""
    if not 0 < temperature < np.inf:
        raise InputError(f"temperature: found {temperature}, expected a positive number")


def _unit_vectors(vectors: np.ndarray, name: str) -> np.ndarray:
    """float64 rows of length 1 to the last digit, of rows that nearly are."""
    vectors = vectors.astype(np.float64)
    lengths = np.sqrt(np.einsum("lc,lc->l", vectors, vectors))
    if not np.isfinite(lengths).all():
        raise InputError(f"relevancy: {name} hold NaN or infinity")
    if not lengths.all():
        raise InputError(f"relevancy: {name} hold a zero vector, which means nothing")
    worst = lengths[np.abs(lengths - 1).argmax()] if len(lengths) else 1.0
    if abs(worst - 1) > UNIT_TOLERANCE:
        raise InputError(
            f"relevancy: {name} hold a vector of length {worst:.4g}, expected unit vectors; divide "
            "each by its length"
        )
    return vectors / lengths[:, None]
