"""Ask an image of object ids for words: find, locate and segment.

Every result is one number an object, spread over the image by id; no pixel is scored on its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.special import expit, logit

from slgaussian.errors import InputError
from slgaussian.language import Encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.language.relevancy import relevancy_gap

NEAR_BEST = 0.7
"""An object is taken with the best one if its gap reaches this share of the best gap."""


@dataclass(frozen=True, eq=False)
class QueryResult:
    """What a text found in one image.

    Attributes
    ----------
    text : str
    relevancy : float32 [H, W]
        In [0, 1]; 0 where there is no object.
    mask : bool [H, W]
        Pixels of the selected objects.
    point : (x, y) or None
        Column and row of one pixel, the best guess of where the best object is, given even if no
        object was good enough for the mask; None if the image shows no object at all.
    score : float
        Relevancy of the best object; 0.5 is "as good as any phrase". 0 without objects.
    objects : tuple of (id, relevancy)
        The selected objects, best first.
    unknown : tuple of str
        Words of the text that the encoder left out.
    """

    text: str
    relevancy: np.ndarray
    mask: np.ndarray
    point: tuple[int, int] | None
    score: float
    objects: tuple[tuple[int, float], ...]
    unknown: tuple[str, ...]


def find(
    text: str,
    ids_map: np.ndarray,
    bank: MemoryBank,
    encoder: Encoder,
    *,
    temperature: float = 10.0,
    threshold: float | None = None,
) -> QueryResult:
    """Find the objects that a text describes.

    Parameters
    ----------
    text : str
    ids_map : int32 [H, W]
        Object id of each pixel, 0 where none; ids must be in the bank.
    bank : MemoryBank
    encoder : Encoder
        The encoder that built the bank.
    temperature : float
        Of the relevancy; changes its scale, never the order of objects.
    threshold : float in (0, 1), optional
        Select every object whose relevancy is above it, as the paper does. Without it the choice
        does not depend on the temperature: objects above 0.5 whose gap to the canonical phrases is
        at least :data:`NEAR_BEST` of the best object's gap, so that all objects that fit about
        equally well are taken, and none if no object fits better than "object" does.

    Raises
    ------
    InputError
        If the text has no known word, the id map does not belong to the bank, or a setting is out
        of range.
    """
    if not 0 < temperature < np.inf:
        raise InputError(f"temperature: found {temperature}, expected a positive number")
    if threshold is not None and not 0 < threshold < 1:
        raise InputError(f"threshold: found {threshold}, expected a number between 0 and 1")
    rows = _bank_rows(ids_map, bank)
    gaps = _gaps([text], bank, encoder)[0]
    scores = expit(temperature * gaps)
    visible = np.flatnonzero(np.bincount(rows.ravel() + 1)[1:])
    ranked = visible[np.argsort(-gaps[visible], kind="stable")]
    best = gaps[ranked[0]] if len(ranked) else -np.inf
    if threshold is None:
        cut = max(NEAR_BEST * best, 0.0)
        chosen = ranked[(gaps[ranked] >= cut) & (gaps[ranked] > 0)]
    else:
        chosen = ranked[gaps[ranked] > logit(threshold) / temperature]
    return QueryResult(
        text=text,
        relevancy=np.append(scores, 0).astype(np.float32)[rows],
        mask=np.isin(np.arange(-1, len(bank)), chosen)[rows + 1],
        point=central_point(rows == ranked[0]) if best > -np.inf else None,
        score=float(expit(temperature * best)),
        objects=tuple((int(bank.ids[row]), float(scores[row])) for row in chosen),
        unknown=encoder.unknown_words(text),
    )


def segment(
    texts: Sequence[str],
    ids_map: np.ndarray,
    bank: MemoryBank,
    encoder: Encoder,
) -> np.ndarray:
    """Give every object the text that describes it best; the temperature cannot change which.

    Returns
    -------
    int32 [H, W]
        0 where there is no object, k + 1 where ``texts[k]`` has the highest relevancy; ties go to
        the first text.

    Raises
    ------
    InputError
        If there is no text, a text has no known word, or the id map does not belong to the bank.
    """
    rows = _bank_rows(ids_map, bank)
    gaps = _gaps(list(texts), bank, encoder)
    winner = np.where(bank.present.any(1), gaps.argmax(0) + 1, 0)
    return np.append(winner, 0).astype(np.int32)[rows]


def central_point(region: np.ndarray) -> tuple[int, int]:
    """The pixel (x, y) = (column, row) of a region that lies deepest inside it.

    In the largest 4-connected component of the bool [H, W] mask (the first in row-major order if
    several are largest), the pixel whose Euclidean distance to the nearest pixel outside is
    largest; the image ends at its edges. Ties go to the first pixel in row-major order.
    """
    x, y, w, h = cv2.boundingRect(region.view(np.uint8))
    window = np.pad(region[y : y + h, x : x + w], 1).view(np.uint8)
    _, components, stats, _ = cv2.connectedComponentsWithStats(window, connectivity=4)
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    # SciPy's distances are roots of exact integers. OpenCV's differ in the last bit with the number
    # of threads, and with them which of several equally deep pixels comes first.
    depth = distance_transform_edt(components == largest)
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return int(column) + x - 1, int(row) + y - 1


def _bank_rows(ids_map: np.ndarray, bank: MemoryBank) -> np.ndarray:
    """Row of the bank for each pixel, -1 where there is no object."""
    if ids_map.ndim != 2 or not np.issubdtype(ids_map.dtype, np.integer):
        raise InputError(f"id map: found {ids_map.dtype} {ids_map.shape}, expected int32 [H, W]")
    table = np.full(max(int(bank.ids.max(initial=0)), int(ids_map.max(initial=0))) + 1, -1)
    table[bank.ids] = np.arange(len(bank))
    if ids_map.min(initial=0) < 0:
        raise InputError(f"id map: found the negative id {ids_map.min()}")
    rows = table[ids_map]
    strange = ids_map[(rows < 0) & (ids_map > 0)]
    if strange.size:
        raise InputError(f"id map: object {strange[0]} is not in the memory bank")
    return rows


def _gaps(texts: list[str], bank: MemoryBank, encoder: Encoder) -> np.ndarray:
    """Relevancy gaps [Q, N] of the texts."""
    if not texts:
        raise InputError("query: found no text, expected at least one")
    queries, canonical = encoder.encode_text(texts), encoder.encode_text(encoder.canonical)
    return relevancy_gap(bank.features, bank.present, queries, canonical)
