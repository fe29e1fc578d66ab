"""The relevancy of an object to a text: section 3.3 of the paper, computed without overflow.

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

so that one feature that fits by chance counts less than several that agree. s is 0.05, or the
encoder's ``soft``, which depends on the spread of its cosines.
"""

from __future__ import annotations

import math

import numpy as np

UNIT_TOLERANCE = 1e-3
"""Largest allowed | |L| - 1 |. Rounding to half precision changes a length by at most 2^-11, half
of that; unnormalised features are refused."""

SOFT_TEMPERATURE = 0.05
"""Default temperature s of the soft maximum over leads. Answers are about as good from 0.02 to
0.1."""

MAX_EXPONENT = math.log(np.finfo(np.float64).max)
"""Largest finite argument of exp."""


class Scorer:
    """Scores texts against a fixed set of objects.

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
        soft: float = SOFT_TEMPERATURE,
    ) -> None:
        self._present = present
        self.looks = _unit_vectors(features[present])
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
        return self.combined(self._cosines(queries) - self._rival + extra_leads)

    def combined(self, leads: np.ndarray) -> np.ndarray:
        """Combine leads float64 [Q, P], one per text and present vector, to gaps [Q, N]."""
        gaps = np.full((len(leads), *self._present.shape), self._unseen)
        gaps[:, self._present] = leads
        if self._rows is None:
            return gaps.max(2, initial=-np.inf)
        nodes = gaps[:, self._rows.T].reshape(len(leads), self._rows.shape[1], -1)
        return _soft_greatest(nodes, self._soft)

    def _cosines(self, texts: np.ndarray) -> np.ndarray:
        # Not BLAS, whose last digit depends on threads and position: equal objects must tie.
        return np.einsum("tc,lc->tl", _unit_vectors(texts), self.looks)


def _soft_greatest(leads: np.ndarray, soft: float) -> np.ndarray:
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


def _unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """Normalise rows, whose length is nearly 1, in float64."""
    vectors = vectors.astype(np.float64)
    return vectors / np.sqrt(np.einsum("lc,lc->l", vectors, vectors))[:, None]
