"""How well a text describes an object: the relevancy of section 3.3 of the paper, computed safely.

The paper's  max_j min_i  exp(T L_j.q) / (exp(T L_j.q) + exp(T L_j.c_i))  is a sigmoid of T times

    gap = max_j ( L_j.q - max_i L_j.c_i )

over the views j that hold the object and the canonical phrases c_i, because the sigmoid is
increasing. No exponential is taken of anything that can overflow, and the gap orders objects the
same way at every temperature, even where the sigmoid has saturated. T = 1 is the formula as
printed; T = 10, the default, is what the field's published code uses.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from slgaussian.errors import InputError


def relevancy(
    features: np.ndarray,
    present: np.ndarray,
    queries: np.ndarray,
    canonical: np.ndarray,
    temperature: float = 10.0,
) -> np.ndarray:
    """Relevancy of every object to every query.

    Parameters
    ----------
    features : float [N, V, C]
        Unit vectors of N objects in V views; rows of absent views are ignored.
    present : bool [N, V]
        Which views hold the object.
    queries : float [Q, C]
        Unit vectors of the texts.
    canonical : float [K, C]
        Unit vectors of the phrases that every query competes with, K at least 1.
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
        If shapes disagree, a used vector is zero or holds NaN, or the temperature is not positive.
    """
    if not 0 < temperature < np.inf:
        raise InputError(f"temperature: found {temperature}, expected a positive number")
    return expit(temperature * relevancy_gap(features, present, queries, canonical))


def relevancy_gap(
    features: np.ndarray, present: np.ndarray, queries: np.ndarray, canonical: np.ndarray
) -> np.ndarray:
    """The gap of the module's formula, float64 [Q, N]; -inf for an object that no view holds.

    Arguments and errors as in :func:`relevancy`.
    """
    if features.ndim != 3 or present.shape != features.shape[:2]:
        raise InputError(
            f"relevancy: found features {features.shape} and present {present.shape}, expected "
            "[N, V, C] and [N, V]"
        )
    for name, texts in (("queries", queries), ("canonical", canonical)):
        if texts.ndim != 2 or texts.shape[1] != features.shape[2] or len(texts) == 0:
            raise InputError(
                f"relevancy: {name} are {texts.shape}, expected [at least 1, {features.shape[2]}]; "
                "texts and regions must come from the same encoder"
            )
    seen = features[present].astype(np.float64)
    for name, vectors in (("features", seen), ("queries", queries), ("canonical", canonical)):
        if not np.isfinite(vectors).all():
            raise InputError(f"relevancy: {name} hold NaN or infinity")
        if not vectors.any(axis=1).all():
            raise InputError(f"relevancy: {name} hold a zero vector, which means nothing")
    # Not a BLAS product, whose last digit depends on threads and place: equal objects must tie.
    cosines = np.einsum("tc,lc->tl", np.concatenate([queries, canonical], dtype=np.float64), seen)
    gaps = np.full((len(queries), *present.shape), -np.inf)
    gaps[:, present] = cosines[: len(queries)] - cosines[len(queries) :].max(0)
    return gaps.max(2, initial=-np.inf)
