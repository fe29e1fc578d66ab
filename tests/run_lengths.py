"""Masks as run lengths, as pycocotools writes them."""

import numpy as np


def encode(mask: np.ndarray) -> str:
    """Return the counts of a mask bool [H, W], as text; see :mod:`slgaussian.formats.rle`."""
    flat = np.asarray(mask, bool).ravel(order="F")
    changes = np.flatnonzero(np.diff(flat, prepend=False))
    counts = np.diff(changes, prepend=0, append=flat.size).tolist()
    text = []
    for k, count in enumerate(counts):
        value = count - counts[k - 2] if k > 2 else count
        while True:
            group, value = value & 31, value >> 5
            last = value == (-1 if group & 16 else 0)
            text.append(chr(48 + group + (0 if last else 32)))
            if last:
                break
    return "".join(text)
