"""Copies of a photograph, told by their content.

A copy shows the same picture at the same moment from the same place: recompressed, resized, in
other colours or tones, cropped, framed or with a bar at the border, turned or mirrored. Two
photographs of one thing differ from copies in that things move against each other between them:
after the second is laid over the first by scale and shift, and its tones are fitted, parts of the
pictures of a walk are still displaced, and only noise remains of a copy.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

SIDE = 256
"""Largest side, pixels, of the square to which pictures are shrunk."""

COARSE_SIDE, MIN_CORRELATION = 8, 0.8
"""Side of the smallest thumbnails, and their correlation below which nothing more is compared."""

BORDER = 0.08
"""Part of each side that is not compared: it may have a frame, or the status bar of a phone."""

MAX_DISPLACEMENT = 1.2e-3
"""Largest displacement of parts of a copy, root mean square, as a fraction of the side. At the last
level, copies of 16 photographs of 15 places have at most 1.0e-3; the worst are an eighth of the
size or clipped. Of all pairs of photographs within 26 places, the nearest have 1.6e-3 (a camera
that hardly moved) and 2.6e-3 (a walk). A finely textured castle at an eighth of its size, aliased,
has 1.6e-3 and is missed."""

MAX_CHANGE = 0.3
"""Largest change of a small part of a copy, in standard deviations of the whole: more is a thing
that was moved before a camera that stood still."""

MIN_DETAIL = 1.0
"""Standard deviation, grey levels, of what blurring takes from a picture, below which there is
nothing to compare."""

LEVELS = ((32, 4, 10.0), (64, 2, 4.0), (128, 1, 2.0), (SIDE, 1, 1.0))
"""Sides of the squares that are compared one after the other, rounds of fitting, and bounds in
units of :data:`MAX_DISPLACEMENT`: tones are fitted less well to small pictures."""

TONE_BINS, PATCHES = 32, 8
"""Number of bins of a curve of tones, and of patches along a side that are displaced."""

MIN_SIDE, MAX_SMALL_CHANGE = 40, 0.06
"""Side, pixels, below which only equal and resized pictures are copies, and the mean difference of
the latter, in standard deviations."""

CROP_ERROR = 0.004
"""Part of the side by which a cropped copy may seem to show what its original does not."""

MAX_CROP = 0.2
"""Largest change of scale, and largest shift, as a fraction of the side, of a cropped copy."""

TURNS = [(quarter, mirror) for mirror in (False, True) for quarter in range(4)]


@dataclass(frozen=True, eq=False)
class Thumbnail:
    """A picture shrunk to squares, for the comparison with others.

    Attributes:
        pixels: uint8 [n, n, 3]. RGB, with ``n`` at most :data:`SIDE`.
        coarse: float32 [64]. Grey values of its middle, of mean 0 and norm 1; 0 if it is blank.
    """

    pixels: np.ndarray
    coarse: np.ndarray

    @staticmethod
    def of(image: np.ndarray) -> Thumbnail:
        """Shrink an image uint8 [H, W, 3]."""
        pixels = _square(image, min(SIDE, *image.shape[:2]))
        return Thumbnail(pixels, normalise(signature(pixels)))


def signature(pixels: np.ndarray, side: int = COARSE_SIDE) -> np.ndarray:
    """Compute the grey values of the middle of a picture, uint8 [H, W, 3] or [H, W].

    Returns:
        float32 [side * side]: Row by row, 0 to 255. Normalised, those of copies are correlated.
    """
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    top, left = (round(BORDER * length) for length in grey.shape)
    middle = grey[top : len(grey) - top, left : grey.shape[1] - left].astype(np.float32)
    return _square(middle, side).ravel()


def normalise(signatures: np.ndarray) -> np.ndarray:
    """Bring signatures [..., n] to mean 0 and norm 1, float32; those of blank pictures become 0."""
    centred = signatures - signatures.mean(-1, keepdims=True, dtype=np.float32)
    norms = np.linalg.norm(centred, axis=-1, keepdims=True)
    blank = norms < MIN_DETAIL * signatures.shape[-1] ** 0.5
    return np.where(blank, 0, centred / np.maximum(norms, 1e-3)).astype(np.float32)


def are_copies(a: Thumbnail, b: Thumbnail, whole: bool = False) -> bool:
    """Return whether two pictures are copies; not if there is too little in them to compare.

    With ``whole``, a copy shows the whole picture as it is: not cropped, turned or mirrored, as a
    flat or symmetric scene looks from two places.
    """
    if np.array_equal(a.pixels, b.pixels):
        return bool((a.pixels != a.pixels[0, 0]).any())
    smallest = min(len(a.pixels), len(b.pixels))
    if smallest < MIN_SIDE:
        first, second = (_square(item.pixels, smallest).astype(np.float32) for item in (a, b))
        resized = len(a.pixels) != len(b.pixels)
        return bool(resized and np.abs(first - second).mean() < MAX_SMALL_CHANGE * first.std())
    squares = b.coarse.reshape(COARSE_SIDE, COARSE_SIDE)
    for quarter, mirror in TURNS[: 1 if whole else None]:
        turned = _turn(squares, quarter, mirror)
        if a.coarse @ turned.ravel() >= MIN_CORRELATION:
            other = _turn(b.pixels, quarter, mirror)
            # Clipped tones can be computed from unclipped ones, but not these from those.
            most = CROP_ERROR if whole else MAX_CROP
            if _explains(a.pixels, other, most) or _explains(other, a.pixels, most):
                return True
    return False


def _square(image: np.ndarray, side: int) -> np.ndarray:
    return cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)


def _turn(image: np.ndarray, quarter: int, mirror: bool) -> np.ndarray:
    return np.rot90(image[:, ::-1] if mirror else image, quarter)


def _explains(a: np.ndarray, b: np.ndarray, most: float) -> bool:
    """Return whether ``b`` is ``a`` up to scale, shift (``most``) and tones, uint8 [n, n, 3]."""
    layout = np.zeros(4)  # scale - 1 of x and y, then shift, as fractions of the side
    smallest = min(len(a), len(b))
    for side, rounds, bound in LEVELS:
        side = min(side, smallest)
        first, second = (
            cv2.GaussianBlur(_square(image, side).astype(np.float32), (0, 0), 1.0)
            for image in (a, b)
        )
        at = (np.arange(side, dtype=np.float32) + 0.5) / side - 0.5
        inner = np.abs(at) < 0.5 - BORDER
        for remaining in range(rounds, -1, -1):
            x, y = ((1 + layout[:2, None]) * at + layout[2:, None] + 0.5) * side - 0.5
            grid = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
            moved = cv2.remap(first, *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            in_x, in_y = (inner & (ends >= 0) & (ends <= side - 1) for ends in (x, y))
            mask = in_y[:, None] & in_x
            predicted = _fit_tones(moved, second, mask)
            grey = second.mean(-1)
            rest = np.where(mask, grey - predicted, 0)
            gy, gx = (np.where(mask, slope, 0) * side for slope in np.gradient(predicted))
            if not remaining:
                break
            slopes = np.stack([gx * at, gy * at[:, None], gx, gy], -1).reshape(-1, 4)
            normal = (slopes.T @ slopes).astype(np.float64)
            normal += np.eye(4) * (1e-3 * np.trace(normal) / 4 + 1e-9)
            layout += np.linalg.solve(normal, slopes.T @ rest.ravel())
            if np.abs(layout).max() > MAX_CROP:
                return False
        bound = 1 if side == smallest else bound
        if _displacement(gx, gy, rest) > bound * MAX_DISPLACEMENT:
            return False
        if side == smallest:
            break
    if np.abs(layout).max() > most:
        return False
    half, shift = (1 + layout[:2]) / 2, np.abs(layout[2:])
    inside, outside = half + shift < 0.5 + CROP_ERROR, half - shift > 0.5 - CROP_ERROR
    if not (inside.all() or outside.all()):
        return False  # each shows what the other does not, as two pictures of a wall do
    size = max(3, side // 16)
    detail = (grey - cv2.GaussianBlur(grey, (0, 0), size / 2))[mask].std()
    change = np.abs(cv2.blur(rest, (size, size))).max()
    return bool(detail >= MIN_DETAIL and change <= MAX_CHANGE * grey[mask].std())


def _fit_tones(image: np.ndarray, other: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Predict the grey values [n, n] of ``other`` by a mix of the channels and of their curves."""
    curves = np.concatenate([image, image, np.ones((*mask.shape, 1), np.float32)], -1)
    for channel in range(3):
        values, wanted = image[..., channel], other[..., channel][mask]
        bins = (values[mask] * (TONE_BINS / 256)).astype(np.int64)
        count, before, after = (
            np.bincount(bins, weights, TONE_BINS) for weights in (None, values[mask], wanted)
        )
        used = count > 0
        level, change = before[used] / count[used], (after - before)[used] / count[used]
        curves[..., channel] = values + np.interp(values, level, change)
    inside, grey = curves[mask].astype(np.float64), other.mean(-1)[mask]
    # Channels that are alike, as those of a grey picture, get equal weights.
    ridge = np.diag([1.0] * 6 + [1e-6]) * mask.sum()
    prior = ridge @ ([1 / 3] * 3 + [0] * 4)
    mix = np.linalg.solve(inside.T @ inside + ridge, inside.T @ grey + prior)
    return curves @ mix.astype(np.float32)


def _displacement(gx: np.ndarray, gy: np.ndarray, rest: np.ndarray) -> float:
    """Compute the displacement that explains most of a difference, root mean square of patches.

    Args:
        gx, gy: float32 [n, n]. Slopes of the picture, grey levels per side.
        rest: float32 [n, n]. Difference of the pictures, grey levels.
    """
    starts = np.arange(PATCHES) * len(rest) // PATCHES
    xx, yy, xy, xr, yr = (
        np.add.reduceat(np.add.reduceat(product, starts, 0), starts, 1).astype(np.float64)
        for product in (gx * gx, gy * gy, gx * gy, gx * rest, gy * rest)
    )
    total = float((xx + yy).sum())
    if total <= 0:
        return np.inf
    damping = 0.005 * total / PATCHES**2
    determinant = (xx + damping) * (yy + damping) - xy**2
    dx = ((yy + damping) * xr - xy * yr) / determinant
    dy = ((xx + damping) * yr - xy * xr) / determinant
    return float((2 * (dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy).sum() / total) ** 0.5)
