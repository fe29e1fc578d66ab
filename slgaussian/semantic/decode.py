"""Decoding of rendered feature images into object ids, with a confidence per pixel.

The paper takes the code nearest in L1 (section 3.2; :class:`NearestCode`). At the border of two
objects compositing mixes their codes, and the mixture can be nearest to the code of a third object:
a halo of wrong ids, one or two pixels wide. :class:`Decoder` therefore decodes only *settled*
pixels by themselves: those whose value is close to an object's code and whose neighbours agree. Any
other pixel gets the nearest code among those of settled pixels near it: where two objects mix, that
of the object with the larger blending weight.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slgaussian.errors import InputError
from slgaussian.kernels.jit import kernel
from slgaussian.labels import MIN_WEIGHT
from slgaussian.language.bank import MemoryBank
from slgaussian.language.nearest import distance, find, make_table, nearest_code

MAX_CODE_DISTANCE = 0.25
"""Largest distance of a settled pixel from its code, as a fraction of the distance from that code
to the next one. Without mixing, 0.5 would be safe."""

MIN_CLOSE_PIXELS = 4
"""Smallest number of pixels, of the 3x3 around a settled pixel and including it, that are close to
its code. A line of mixtures that crosses a third code is mostly thinner."""

SEARCH_RADIUS = 2
"""Unsettled pixels choose among the objects of settled pixels at most this many rows and columns
away: 5x5 pixels."""


class Decoder:
    """Decodes feature images of one bank.

    Args:
        bank: The codes and ids.
    """

    def __init__(self, bank: MemoryBank) -> None:
        self._ids = bank.ids
        self._codes = bank.codes.astype(np.float64)
        self._table = make_table(self._codes) if len(bank) else None
        self._gaps = _gaps(self._codes)

    def __call__(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Decode the object of each pixel, with a confidence.

        Args:
            features: float32 [H, W, 4]. Rendered features: code times weight, and the weight.

        Returns:
            ids: int32 [H, W]. Ids of the bank, 0 where the weight is below :data:`MIN_WEIGHT`.
            confidence: float32 [H, W]. In [0, 1]; approximates the blending weight of the object
                minus that of the next one, ``1 - 2 s`` for a mixture with fraction s. At a settled
                pixel it is the weight times ``1 - 2 d / g``, with ``d`` the distance to its code
                and ``g`` that from this code to the next; elsewhere the weight times ``(e - d) /
                (e + d)``, with ``e`` the distance to the second nearest candidate. 0 without an
                object, or without a second candidate.

        Raises:
            InputError: If the shape is wrong, or a value is NaN or infinite.
        """
        ids, confidence = _make_empty_maps(features)
        if self._table is not None:
            _decode(features, self._codes, *self._table, self._gaps, self._ids, ids, confidence)
        return ids, confidence


class NearestCode(Decoder):
    """The paper's decoding (section 3.2): the code nearest in L1, independently per pixel.

    Rendered codes are not divided by their weight, so partly transparent ones are biased to zero.
    """

    def __call__(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`Decoder.__call__`; the confidence is ``1 - 2 d / g`` times the weight."""
        ids, confidence = _make_empty_maps(features)
        if len(self._ids):
            visible = features[..., -1] >= MIN_WEIGHT
            rendered = features[visible].astype(np.float64)
            nearest = nearest_code(rendered[:, :-1], self._codes)
            distances = np.abs(rendered[:, :-1] - self._codes[nearest]).sum(1)
            ids[visible] = self._ids[nearest]
            lead = np.maximum(0, 1 - 2 * distances / self._gaps[nearest])
            confidence[visible] = np.minimum(rendered[:, -1], 1) * lead
        return ids, confidence


def _make_empty_maps(features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if features.ndim != 3 or features.shape[2] != 4:
        raise InputError(f"decode: found features {features.shape}, expected [H, W, 4]")
    if not np.isfinite(features).all():
        raise InputError("decode: features hold NaN or infinity")
    return np.zeros(features.shape[:2], np.int32), np.zeros(features.shape[:2], np.float32)


def make_decoder(bank: MemoryBank, settings: Mapping[str, Any]) -> Decoder:
    """Make the decoder that the build settings of a field ask for."""
    options = settings.get(str(settings.get("codes")), {})
    return NearestCode(bank) if options.get("decode") == "nearest" else Decoder(bank)


def find_labels(features: np.ndarray, bank: MemoryBank) -> np.ndarray:
    """Find the main object of each Gaussian by its ``features`` [N, 4]: int32 [N], 0 for none."""
    labelled = features[:, -1] >= MIN_WEIGHT
    ids = np.zeros(len(features), np.int32)
    if labelled.any():
        rows = nearest_code(features[labelled, :-1] / features[labelled, -1:], bank.codes)
        ids[labelled] = bank.ids[rows]
    return ids


def _gaps(codes: np.ndarray) -> np.ndarray:
    """Compute the L1 distance from each code to the nearest other one, float64 [N]; inf if none."""
    distances = np.array([np.abs(codes - code).sum(1) for code in codes]).reshape(2 * (len(codes),))
    np.fill_diagonal(distances, np.inf)
    return distances.min(1, initial=np.inf)


# Single-threaded: an image takes 3 ms, and starting a second thread may cost more than it saves.


@kernel
def _decode(features, codes, starts, members, gaps, table, ids, confidence):
    """Write ``ids`` and ``confidence`` of an image."""
    height, width = ids.shape
    rows, lead = np.empty((height, width), np.int32), np.empty((height, width), np.float32)
    # Padded, so that the neighbourhood loops need no bounds checks.
    close = np.full((height + 2, width + 2), -1, np.int32)
    agreed = np.full((height + 2 * SEARCH_RADIUS, width + 2 * SEARCH_RADIUS), -1, np.int32)
    for v in range(height):
        _nearest(features[v], codes, starts, members, gaps, rows[v], close[v + 1], lead[v])
    for v in range(height):
        _find_settled_codes(close[v], close[v + 1], close[v + 2], agreed[v + SEARCH_RADIUS])
    for v in range(height):
        window = agreed[v : v + 2 * SEARCH_RADIUS + 1]
        _decode_row(features[v], codes, rows[v], lead[v], window, table, ids[v], confidence[v])


@kernel
def _nearest(features, codes, starts, members, gaps, rows, close, lead):
    """Find the nearest code of each pixel of an image row, -1 where none is visible, and its lead.

    ``close`` gets the code, one pixel to the right, where it is within :data:`MAX_CODE_DISTANCE`.
    """
    row, near = np.uint32(0), -1.0
    at_x, at_y, at_z, per_gap = 0.0, 0.0, 0.0, 0.0
    for u in range(len(rows)):
        weight = features[u, 3]
        rows[u] = -1
        if weight < MIN_WEIGHT:
            continue
        x = np.float64(features[u, 0] / weight)  # divided in float32
        y = np.float64(features[u, 1] / weight)
        z = np.float64(features[u, 2] / weight)
        # Closer than half way to the next code, the previous pixel's code is still the nearest.
        d = abs(x - at_x) + abs(y - at_y) + abs(z - at_z)
        if not d < near:
            row, d = find(x, y, z, codes, starts, members)
            at_x, at_y, at_z = codes[row, 0], codes[row, 1], codes[row, 2]
            near, per_gap = 0.499999 * gaps[row], 1 / gaps[row]
        fraction = d * per_gap
        rows[u] = row
        lead[u] = max(0.0, 1 - 2 * fraction)
        if fraction <= MAX_CODE_DISTANCE:
            close[u + 1] = row


@kernel
def _find_settled_codes(above, close, below, agreed):
    """Copy the codes of ``close`` with which enough neighbours agree."""
    for u in range(1, len(close) - 1):
        row = close[u]
        agree = (above[u - 1] == row) + (above[u] == row) + (above[u + 1] == row)
        agree += (close[u - 1] == row) + (close[u + 1] == row)
        agree += (below[u - 1] == row) + (below[u] == row) + (below[u + 1] == row)
        agreed[u - 1 + SEARCH_RADIUS] = row if agree + 1 >= MIN_CLOSE_PIXELS else -1


@kernel
def _decode_row(features, codes, rows, leads, agreed, table, ids, confidence):
    """Write ids and confidence of an image row; ``agreed`` is padded by :data:`SEARCH_RADIUS`."""
    for u in range(len(rows)):
        row = rows[u]
        if row < 0:
            continue
        weight, lead = features[u, 3], leads[u]
        if agreed[SEARCH_RADIUS, u + SEARCH_RADIUS] < 0:
            x = np.float64(features[u, 0] / weight)
            y = np.float64(features[u, 1] / weight)
            z = np.float64(features[u, 2] / weight)
            row, lead = _choose(x, y, z, codes, agreed[:, u : u + 2 * SEARCH_RADIUS + 1], row, lead)
        ids[u] = table[row]
        confidence[u] = min(weight, np.float32(1)) * lead


@kernel
def _choose(x, y, z, codes, agreed, row, lead):
    """Choose the nearest of the settled neighbours' codes; return its row and lead.

    Ties go to the lowest row. Without a settled neighbour ``row`` and ``lead`` are returned.
    """
    best, second, chosen, last = np.inf, np.inf, np.int32(-1), np.int32(-1)
    for v in range(2 * SEARCH_RADIUS + 1):
        for u in range(2 * SEARCH_RADIUS + 1):
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
