"""From a rendered feature image back to object ids, and how sure each pixel is.

The paper takes the code nearest in L1 (section 3.2; :class:`NearestCode`). At the border of two
objects compositing mixes their codes, and the mixture can be nearest to the code of a third: a halo
of wrong ids, one or two pixels wide. So only *settled* pixels answer for themselves: their code is
close to an object's, and pixels around them say the same. The others choose among the objects of
settled pixels near them, the nearest code again: where two objects mix, that is the one with more
of the light.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel
from slgaussian.labels import VISIBLE
from slgaussian.language.bank import MemoryBank
from slgaussian.language.nearest import distance, find, make_lookup

CLOSE = 0.25
"""A settled pixel is off its code by at most this fraction of the distance from that code to the
next: half would be safe if nothing were mixed in."""

AGREE = 4
"""At least so many of the 3x3 pixels around a settled one, itself included, are close to its code.
A line of mixtures that crosses a third code is thinner than that mostly."""

REACH = 2
"""Unsettled pixels choose among the objects of settled pixels at most this many rows and columns
away: 5x5 pixels."""


class Decoder:
    """Decodes the images of one bank; making it costs some milliseconds, once.

    Parameters
    ----------
    bank : MemoryBank
        With codes [N, D], D from 1 to 3.
    """

    def __init__(self, bank: MemoryBank) -> None:
        self._ids = bank.ids
        self._dimension = bank.codes.shape[1]
        self._lookup = make_lookup(bank.codes) if len(bank) else None
        self._gaps = _gaps(bank.codes.astype(np.float64))

    def __call__(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The object that each pixel shows, and how sure that is.

        Parameters
        ----------
        features : float32 [H, W, D + 1]
            As rendered: code times weight, and the weight.

        Returns
        -------
        ids : int32 [H, W]
            Ids of the bank, 0 where the weight is below :data:`VISIBLE`.
        confidence : float32 [H, W]
            About the fraction of the pixel's light by which its object leads the next one, from 0
            to 1: the weight times ``1 - 2 d / g`` at a settled pixel, ``d`` from its code and ``g``
            from there to the next code, and times ``(e - d) / (e + d)`` at others, ``e`` from the
            next object that it could choose. A mixture of two objects, s of the second, is s of the
            way from code to code, so both are ``1 - 2 s`` or less. 0 where there is no object, and
            where nothing near tells how good the choice was.

        Raises
        ------
        InputError
            If the shape is another, or a number is NaN or infinite where an object is visible.
        """
        if features.ndim != 3 or features.shape[2] != self._dimension + 1:
            raise InputError(
                f"decode: found features {features.shape}, expected [H, W, {self._dimension + 1}]"
            )
        shape = features.shape[:2]
        ids, confidence = np.zeros(shape, np.int32), np.zeros(shape, np.float32)
        if self._lookup is None:
            return ids, confidence
        bad = _decode(features, self._lookup, self._gaps, self._ids, ids, confidence)
        if bad.any():
            raise InputError(
                f"decode: features in image row {int(bad.argmax())} hold NaN or infinity"
            )
        return ids, confidence


class NearestCode:
    """The paper's decoding (section 3.2): each pixel by itself is the code nearest in L1.

    A rendered code is not divided by its weight, so one that is drawn thinly lies nearer to zero.

    Parameters
    ----------
    bank : MemoryBank
        With codes [N, D], D from 1 to 3.
    """

    def __init__(self, bank: MemoryBank) -> None:
        self._ids = bank.ids
        self._codes = bank.codes.astype(np.float64)
        self._gaps = _gaps(self._codes)

    def __call__(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`Decoder.__call__`; the confidence is ``1 - 2 d / g`` times the weight."""
        ids, confidence = np.zeros(features.shape[:2], np.int32), np.zeros(features.shape[:2], "f4")
        visible = features[..., -1] >= VISIBLE
        if not visible.any() or not len(self._ids):
            return ids, confidence
        drawn = features[visible].astype(np.float64)
        if not np.isfinite(drawn).all():
            row = int(np.argwhere(visible)[np.isfinite(drawn).all(1).argmin(), 0])
            raise InputError(f"decode: features in image row {row} hold NaN or infinity")
        from scipy.spatial import cKDTree

        distance, nearest = cKDTree(self._codes).query(drawn[:, :-1], p=1)
        ids[visible] = self._ids[nearest]
        lead = np.maximum(0, 1 - 2 * distance / self._gaps[nearest])
        confidence[visible] = np.minimum(drawn[:, -1], 1) * lead
        return ids, confidence


def decoder_of(bank: MemoryBank, settings: Mapping[str, Any]) -> Decoder | NearestCode:
    """The decoder of a field, as the settings that it was built by have it."""
    options = settings.get(str(settings.get("codes")), {})
    return NearestCode(bank) if options.get("decode") == "nearest" else Decoder(bank)


def elected_ids(
    label: np.ndarray, weights: np.ndarray, ids: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As :class:`Decoder`, of a picture drawn with ``labels``: rows of ``ids`` int32 [N], from 1.

    ``label`` and ``weights`` are the picture's ``label`` and ``label_weights``, as arrays. The
    confidence is the lead of the object over the next one itself.
    """
    best, second, total = np.moveaxis(weights, -1, 0)
    visible = total >= VISIBLE
    decoded = np.append(np.int32(0), ids)[label * visible]
    return decoded, np.where(visible, np.minimum(best - second, np.float32(1)), np.float32(0))


def _gaps(codes: np.ndarray) -> np.ndarray:
    """L1 distance from each code to the nearest other one, float64 [N]; infinite if it is alone."""
    if len(codes) == 0:
        return np.zeros(0)
    gaps = np.full(len(codes), np.inf)
    for row, code in enumerate(codes):  # a tree would be as fast, and takes long to import
        distances = np.abs(codes - code).sum(1)
        distances[row] = np.inf
        gaps[row] = distances.min()
    return gaps


# On one thread: an image is 3 ms of work, and waiting for a second one may cost more than it saves.


@kernel
def _decode(features, lookup, gaps, table, ids, confidence):
    """Write ``ids`` and ``confidence``; returns which image rows hold what is no number."""
    height, width = ids.shape
    codes, (across, down, deep), starts, members = lookup
    bad = np.zeros(height, np.bool_)
    rows, lead = np.empty((height, width), np.int32), np.empty((height, width), np.float32)
    # With a margin, so that what looks around need not ask whether it is still in the image.
    close = np.full((height + 2, width + 2), -1, np.int32)
    agreed = np.full((height + 2 * REACH, width + 2 * REACH), -1, np.int32)
    for v in range(height):
        bad[v] = _nearest(
            features[v], codes, across, down, deep, starts, members, gaps, rows[v], close[v + 1],
            lead[v],
        )  # fmt: skip
    for v in range(height):
        _settle(close[v], close[v + 1], close[v + 2], agreed[v + REACH])
    for v in range(height):
        around = agreed[v : v + 2 * REACH + 1]
        _answer(features[v], codes, rows[v], lead[v], around, table, ids[v], confidence[v])
    return bad


@kernel
def _nearest(features, codes, across, down, deep, starts, members, gaps, rows, close, lead):
    """Nearest code of each pixel of an image row, -1 where none is visible, and its lead.

    ``close`` is the same one pixel to the right, where it is :data:`CLOSE`. Returns whether there
    is something that is no number.
    """
    channels = features.shape[1]
    x, y, z, bad = 0.0, 0.0, 0.0, False
    row, near = np.uint32(0), -1.0
    at_x, at_y, at_z, per_gap = 0.0, 0.0, 0.0, 0.0
    for u in range(len(rows)):
        weight = features[u, channels - 1]
        rows[u] = -1
        if weight < VISIBLE:
            continue
        # In float32. The last channel, over itself, stands for one that there is not.
        x = np.float64(features[u, 0] / weight)
        if channels > 2:
            y = np.float64(features[u, 1] / weight)
        if channels > 3:
            z = np.float64(features[u, 2] / weight)
        if not abs(x) + abs(y) + abs(z) + weight < np.inf:
            bad = True
            continue
        # Less than half way to the next code no other can be nearer, and neighbours are alike.
        d = abs(x - at_x) + abs(y - at_y) + abs(z - at_z)
        if not d < near:
            row, d = find(x, y, z, codes, across, down, deep, starts, members)
            at_x, at_y, at_z = codes[row, 0], codes[row, 1], codes[row, 2]
            near, per_gap = 0.499999 * gaps[row], 1 / gaps[row]
        fraction = d * per_gap
        rows[u] = row
        lead[u] = max(0.0, 1 - 2 * fraction)
        if fraction <= CLOSE:
            close[u + 1] = row
    return bad


@kernel
def _settle(above, close, below, agreed):
    """Copy those of ``close`` that enough pixels around agree with."""
    for u in range(1, len(close) - 1):
        row = close[u]
        agree = (above[u - 1] == row) + (above[u] == row) + (above[u + 1] == row)
        agree += (close[u - 1] == row) + (close[u + 1] == row)
        agree += (below[u - 1] == row) + (below[u] == row) + (below[u + 1] == row)
        agreed[u - 1 + REACH] = row if agree + 1 >= AGREE else -1


@kernel
def _answer(features, codes, rows, leads, agreed, table, ids, confidence):
    """Ids and confidence of an image row; ``settled`` has :data:`REACH` more on every side."""
    channels = features.shape[1]
    x, y, z = 0.0, 0.0, 0.0
    for u in range(len(rows)):
        row = rows[u]
        if row < 0:
            continue
        weight, lead = features[u, channels - 1], leads[u]
        if agreed[REACH, u + REACH] < 0:
            x = np.float64(features[u, 0] / weight)
            if channels > 2:
                y = np.float64(features[u, 1] / weight)
            if channels > 3:
                z = np.float64(features[u, 2] / weight)
            row, lead = _choose(x, y, z, codes, agreed[:, u : u + 2 * REACH + 1], row, lead)
        ids[u] = table[row]
        confidence[u] = min(weight, np.float32(1)) * lead


@kernel
def _choose(x, y, z, codes, agreed, row, lead):
    """The nearest code of settled pixels, and its lead; ties go to the lowest row.

    Without a settled pixel it is ``row``, with its ``lead``.
    """
    best, second, chosen, last = np.inf, np.inf, np.int32(-1), np.int32(-1)
    for v in range(2 * REACH + 1):
        for u in range(2 * REACH + 1):
            rival = agreed[v, u]
            if rival in (last, chosen) or rival < 0:
                continue
            last = rival
            d = distance(x, y, z, codes, rival)
            if d < best or (d == best and rival < chosen):
                best, second, chosen = d, best, rival
            elif d < second:
                second = d
    if chosen < 0:
        return row, lead
    if second == np.inf:
        return chosen, lead if chosen == row else np.float32(0)
    return chosen, np.float32((second - best) / (second + best))
