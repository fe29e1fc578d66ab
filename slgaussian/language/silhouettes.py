"""Shape words: IoU of a mask with silhouettes of ideal solids.

The silhouettes of a box, a cylinder, a cone, a ball and a ring are rendered from a range of
viewpoints above the horizon, in parallel projection, and resized to a square. Masks are resized
likewise and compared by intersection over union with silhouettes of a similar aspect ratio.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from slgaussian.kernels.threads import processor
from slgaussian.storage.local_copies import cached_arrays

SOLIDS = ("ball", "box", "cylinder", "cone", "ring")

_SIDE = 40
_FULL = 64.0  # integer value of full coverage: sums of products are exact in float32
_TILTS = np.radians([3, 8, 13, 18, 24, 30, 38])  # of the line of sight below the horizon
_LEANS = np.radians([-12, -6, 0, 6, 12])  # verticals converge away from the image centre
_TURNS = np.radians([0, 18, 36, 54, 72])
_HEIGHTS = np.geomspace(0.5, 3.6, 8)  # in widths
_ASPECT_STEP = 1.25  # largest ratio between the aspects of a mask and of an outline


def match(masks: Sequence[np.ndarray]) -> np.ndarray:
    """Compute how well each mask matches each of :data:`SOLIDS`, float64 [M, 5] in [0, 1].

    ``masks`` are non-empty bool arrays of any sizes. 1 is a perfect match; 0 means that no outline
    of that solid has a similar aspect ratio. The score is the soft IoU a.b / (a.a + b.b - a.b),
    which allows partly covered pixels.
    """
    outlines, sizes, aspects, kinds = _outlines()
    boxes = [cv2.boundingRect(mask.view(np.uint8)) for mask in masks]
    squares = np.array(
        [_stretch(m[y : y + h, x : x + w]) for m, (x, y, w, h) in zip(masks, boxes, strict=True)]
    )
    shared = squares.reshape(len(masks), -1) @ outlines.T
    iou = shared / (sizes + (squares**2).sum(-1)[:, None] - shared)
    aspect = np.log([w / h for _, _, w, h in boxes])
    iou[np.abs(aspect[:, None] - aspects) > np.log(_ASPECT_STEP)] = 0
    return np.stack([iou[:, kinds == k].max(1) for k in range(len(SOLIDS))], 1).astype(np.float64)


def _stretch(mask: np.ndarray) -> np.ndarray:
    """Resize the mask [h, w] to a flattened square of integer coverages, float32."""
    how = cv2.INTER_AREA if min(mask.shape) >= _SIDE else cv2.INTER_LINEAR
    cover = cv2.resize(mask.astype(np.float32), (_SIDE, _SIDE), interpolation=how)
    return np.round(cover.ravel() * _FULL)


@cache
def _outlines() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return all outlines: squares [T, SIDE^2], squared norms, log aspects, indices into SOLIDS.

    They are cached on disk, keyed by this file, the version of OpenCV and the CPU.
    """
    key = Path(__file__).read_bytes() + f"{cv2.__version__} {processor()}".encode()
    cached = cached_arrays(f"outlines/{hashlib.sha256(key).hexdigest()}.npz", _draw_outlines)
    squares = cached["squares"].astype(np.float32)
    return squares, (squares**2).sum(1), cached["aspects"], cached["kinds"]


def _draw_outlines() -> dict[str, np.ndarray]:
    squares, aspects, kinds = [], [], []
    for kind, points, tube in _solids():
        low, high = points.min(0) - tube, points.max(0) + tube
        scale = 160 / (high - low).max()
        pixels = np.round((points - low) * scale).astype(np.int32)
        w, h = np.ceil((high - low) * scale).astype(int) + 1
        canvas = np.zeros((h, w), np.uint8)
        if tube:
            cv2.polylines(canvas, [pixels], True, 1, max(1, round(2 * tube * scale)))
        else:
            cv2.fillConvexPoly(canvas, cv2.convexHull(pixels), 1)
        squares.append(_stretch(canvas))
        aspects.append(np.log(w / h))
        kinds.append(SOLIDS.index(kind))
    return {
        "squares": np.stack(squares).astype(np.uint8),  # integers up to _FULL
        "aspects": np.array(aspects),
        "kinds": np.array(kinds),
    }


def _solids() -> Iterator[tuple[str, np.ndarray, float]]:
    """Yield (kind, projected points [P, 2], tube radius) of every solid and view, width ~ 1."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) / 2
    base = np.array([(x, y, 0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    up = np.array([[0, 0, 1.0]])
    yield "ball", circle[:, :2], 0.0
    for tilt, lean in product(_TILTS, _LEANS):
        for height in _HEIGHTS:
            top = height * up
            yield "cylinder", _project(np.concatenate([circle, circle + top]), tilt, lean), 0.0
            yield "cone", _project(np.concatenate([circle, top]), tilt, lean), 0.0
            for turn, depth in product(_TURNS, (0.6, 1.0)):
                foot = base * (1, depth, 1) @ _rotation(turn)
                yield "box", _project(np.concatenate([foot, foot + top]), tilt, lean), 0.0
    for tilt, tube in product([*_TILTS, np.radians(60)], (0.16, 0.24, 0.32)):
        lying = circle * (1 - tube)
        for lean in _LEANS:
            yield "ring", _project(lying, tilt, lean), tube / 2
        for turn in _TURNS:
            yield "ring", _project(lying[:, [0, 2, 1]] @ _rotation(turn), tilt), tube / 2


def _rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _project(points: np.ndarray, tilt: float, lean: float = 0.0) -> np.ndarray:
    """Project points (z up) along +y, from ``tilt`` above the horizon, to x right, y down."""
    flat = np.stack([points[:, 0], -np.cos(tilt) * points[:, 2] - np.sin(tilt) * points[:, 1]], 1)
    return flat @ _rotation(lean)[:2, :2]
