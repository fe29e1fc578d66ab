"""Quality of photographs, blur and exposure on a small grey image, and the choice of keyframes."""

from __future__ import annotations

import io
from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.formats.colour import is_srgb, read_colours
from slgaussian.formats.images import open_image
from slgaussian.scene import Camera

SMALL_SIDE = 180
"""Shorter side of the small image, pixels. A JPEG of 640 x 360 is decoded at half its size for it,
in a third of the time."""

REBLUR_WIDTH = 7
"""Width of the additional blur, pixels, which hardly changes an image that is already blurred."""

CLIPPED_GREYS = 4
"""Grey levels from black or white that count as clipped."""


def glance(data: bytes) -> tuple[np.ndarray, tuple[int, int]]:
    """Decode a photograph in grey, its shorter side :data:`SMALL_SIDE` pixels or fewer.

    Returns:
        uint8 [h, w], (width, height): The small image, and the full size of the photograph.

    Raises:
        InputError: If it cannot be decoded.
    """
    try:
        with open_image(io.BytesIO(data)) as image:
            size = image.size
            if not is_srgb(image):
                return small(read_colours(image, "photograph")), size
            image.draft("L", _small_size(*size))
            grey = np.asarray(image.convert("L"))
    except ValueError as error:
        raise InputError(f"its JPEG cannot be decoded ({error})") from None
    return cv2.resize(grey, _small_size(*size), interpolation=cv2.INTER_AREA), size


def small(image: np.ndarray) -> np.ndarray:
    """Convert a photograph uint8 [H, W, 3] to the grey small image of :func:`glance`."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, _small_size(*grey.shape[::-1]), interpolation=cv2.INTER_AREA)


def _small_size(width: int, height: int) -> tuple[int, int]:
    scale = min(1.0, SMALL_SIDE / min(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def blur(grey: np.ndarray) -> float:
    """Measure the blur of an image uint8 [h, w] from 0, sharp, to 1; without any edge 1.

    It is the fraction of edge strength that remains after another blur, in the worse of the two
    directions (Crete et al., "The blur effect", 2007). Unlike the variance of the Laplacian it
    hardly depends on the content: a sharp photograph of a blank door counts as sharp.
    """
    if min(grey.shape) < REBLUR_WIDTH:
        return 1.0
    from skimage.measure import blur_effect  # slow import, needed only to choose views

    return float(blur_effect(grey, h_size=REBLUR_WIDTH))


def exposure(grey: np.ndarray) -> tuple[float, float]:
    """Return the mean of pixels uint8 [...], 0 to 1, and the fraction of clipped pixels."""
    clipped = (grey <= CLIPPED_GREYS) | (grey >= 255 - CLIPPED_GREYS)
    return float(grey.mean() / 255), float(clipped.mean())


def choose_keyframes(
    blurs: Sequence[float], count: int, cameras: Sequence[Camera] | None = None
) -> list[int]:
    """Choose keyframes that cover the content of a video; return their indices, ascending.

    The camera path is divided into ``count`` equal segments, and the sharpest frame in the middle
    half of each is chosen, or else of the whole segment. Path length is translation plus rotation,
    each as a fraction of its total, so a camera at rest adds nothing. Without cameras, frames are
    assumed to be evenly spaced. A segment without a frame gives no keyframe.

    Args:
        blurs: sequence of N float. :func:`blur` of every frame, in temporal order.
        count: Two or more.
        cameras: sequence of N Camera, optional

    Raises:
        InputError: If ``count`` is below two.
    """
    if count < 2:
        raise InputError(f"keyframes: found {count}, expected two or more")
    if len(blurs) <= count:
        return list(range(len(blurs)))
    way = np.linspace(0, 1, len(blurs))
    if cameras is not None:
        centers = np.array([camera.center for camera in cameras])
        axes = np.array([camera.c2w[:3, 2] for camera in cameras])
        moved = np.linalg.norm(np.diff(centers, axis=0), axis=1)
        turned = np.arccos((axes[1:] * axes[:-1]).sum(1).clip(-1, 1))
        shares = [steps / steps.sum() for steps in (moved, turned) if steps.any()]
        if shares:
            way[1:] = np.cumsum(np.mean(shares, axis=0))
    part = way * count
    segment = np.minimum(part.astype(int), count - 1)
    middle = np.abs(part - segment - 0.5) <= 0.25
    chosen = []
    for k in range(count):
        inside = np.flatnonzero(segment == k)
        inside = inside[middle[inside]] if middle[inside].any() else inside
        if len(inside):
            chosen.append(int(inside[np.argmin(np.asarray(blurs)[inside])]))
    return chosen
