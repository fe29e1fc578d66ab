"""Sub-pixel refinement of matches by aligning the patch around one feature to the other photograph.

Features are detected in each photograph separately, with an error of about a third of a pixel.
Lucas-Kanade alignment of the patches (IJCAI 1981), affine and invariant to brightness and contrast,
halves the error in sharp photographs. `docs/measured/poses.md` gives the effect on poses.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.cameras.matches import Features

PATCH_RADIUS, PATCH_SCALE = 7, 3.0
"""Samples of a patch on each side of its centre; its half width in units of the feature's scale."""
PYRAMID_LEVELS = 5
ITERATIONS = 8
MIN_CORRELATION = 0.8
"""Smallest correlation of the aligned patches."""
MAX_SHIFT = 1.5
"""Largest shift of a feature, in units of its scale or pixels, whichever is larger."""


def sharpen(
    greys: tuple[np.ndarray, np.ndarray], a: Features, b: Features, i: np.ndarray, j: np.ndarray
) -> np.ndarray:
    """Locate features ``i`` of the first image in the second image, near their matches ``j``.

    Args:
        greys: uint8 [H, W] each
        a, b: Features of the two images.
        i, j: int [M]

    Returns:
        float64 [M, 2]: Pixels; the positions of ``b`` where the alignment fails.
    """
    initial = b.points[j]
    if not len(i):
        return initial
    levels = [_pyramid(grey) for grey in greys]
    grid = np.stack(np.meshgrid(*[np.arange(-PATCH_RADIUS, PATCH_RADIUS + 1.0)] * 2), -1).reshape(
        -1, 2
    )
    weight = np.exp(-(grid**2).sum(1) / (2 * (0.6 * PATCH_RADIUS) ** 2))
    step = PATCH_SCALE * a.scales[i] / PATCH_RADIUS
    zoom, turn = b.scales[j] / a.scales[i], b.angles[j] - a.angles[i]
    cos, sin = np.cos(turn), np.sin(turn)
    warp = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], 1)
    warp = warp * (step * zoom)[:, None, None]
    fine = _level(step), _level(step * zoom)
    offsets = step[:, None, None] * grid
    reference = _normalise(_sample(levels[0], fine[0], a.points[i], offsets), weight)
    at, patches = initial.copy(), reference
    side = 2 * PATCH_RADIUS + 1
    for _ in range(ITERATIONS):
        patches = _normalise(_sample(levels[1], fine[1], at, grid @ warp.mT), weight)
        down, across = np.gradient(patches.reshape(-1, side, side), axis=(1, 2))
        slope = np.stack([across.reshape(len(at), -1), down.reshape(len(at), -1)], -1)
        jacobian = np.concatenate([slope, slope[..., :1] * grid, slope[..., 1:] * grid], -1)
        weighed = jacobian * weight[:, None]
        hessian = weighed.mT @ jacobian
        damping = 1e-3 / 6 * np.trace(hessian, axis1=1, axis2=2) + 1e-9
        hessian += damping[:, None, None] * np.eye(6)
        gradient = np.einsum("mnk,mn->mk", weighed, reference - patches)
        move = np.linalg.solve(hessian, gradient[..., None])[..., 0].clip(-1.5, 1.5)
        at = at + np.einsum("mij,mj->mi", warp, move[:, :2])
        warp = warp @ (np.eye(2) + move[:, 2:].reshape(-1, 2, 2).clip(-0.2, 0.2))
    likeness = (weight * reference * patches).sum(1)
    moved = np.linalg.norm(at - initial, axis=1)
    good = (likeness > MIN_CORRELATION) & (moved < MAX_SHIFT * np.maximum(b.scales[j], 1.0))
    return np.where(good[:, None], at, initial)


def _pyramid(grey: np.ndarray) -> list[np.ndarray]:
    levels = [grey.astype(np.float32)]
    while len(levels) < PYRAMID_LEVELS and min(levels[-1].shape) > 2:
        levels.append(cv2.pyrDown(levels[-1]))
    return levels


def _level(step: np.ndarray) -> np.ndarray:
    """Return the pyramid level [M] whose pixel spacing is closest to ``step`` [M]."""
    return np.clip(np.round(np.log2(step)), 0, PYRAMID_LEVELS - 1).astype(int)


def _sample(
    levels: Sequence[np.ndarray], level: np.ndarray, at: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """Sample grey values float64 [M, S] at pixels [M, 2] plus offsets [M, S, 2], at levels [M]."""
    places = ((at[:, None] + offsets - 0.5) / 2.0 ** level[:, None, None]).astype(np.float32)
    out = np.empty(places.shape[:2])
    for k, image in enumerate(levels):
        # The smallest image is used for levels that do not exist.
        selected = level == k if k < len(levels) - 1 else level >= k
        x, y = places[selected, :, 0], places[selected, :, 1]
        if selected.any():
            border = cv2.BORDER_REPLICATE
            out[selected] = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=border)
    return out


def _normalise(patches: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Normalise patches [M, S] to mean 0 and norm 1 under ``weight`` [S]."""
    centred = patches - (weight * patches).sum(1, keepdims=True) / weight.sum()
    return centred / np.sqrt((weight * centred**2).sum(1, keepdims=True) + 1e-6)
