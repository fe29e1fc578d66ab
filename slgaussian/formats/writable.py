"""What Gaussians must fulfil to be written as a file of any format."""

from __future__ import annotations

import numpy as np

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians


def check_writable(gaussians: Gaussians, kind: str, least: int = 0) -> None:
    """Raise :class:`InputError` if a file cannot hold these Gaussians.

    Args:
        kind: The format with its article, such as "an .spz".
        least: Smallest number of Gaussians that the format can hold.

    Raises:
        InputError: If there are fewer Gaussians, one of them is invalid
            (:meth:`slgaussian.gaussians.Gaussians.check`), or the degree of the harmonics is not 0
            to 3.
    """
    if len(gaussians) < least:
        raise InputError(f"gaussians: found none, and {kind} holds {least} or more")
    gaussians.check()
    terms = gaussians.to_arrays()["sh"].shape[1]
    if terms not in (1, 4, 9, 16):
        raise InputError(
            f"gaussians sh: found {terms} coefficients a colour, expected 1, 4, 9 or 16: {kind} "
            "holds harmonics of degree 0 to 3"
        )


def check_labels(labels: np.ndarray, n: int) -> np.ndarray:
    """Return labels as an array; InputError unless they are n integers of 32 bits."""
    labels = np.asarray(labels)
    if labels.shape != (n,) or labels.dtype.kind not in "iu":
        raise InputError(
            f"labels: found {labels.dtype} {labels.shape}, expected an integer a Gaussian, ({n},)"
        )
    if n and not -(2**31) <= labels.min() <= labels.max() < 2**31:
        raise InputError(f"labels: found {labels.min()} to {labels.max()}, expected 32-bit numbers")
    return labels
