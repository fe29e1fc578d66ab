"""Relative geometry of two views, from given poses and refined for matching by sparse matches."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from scipy.optimize import least_squares

from slgaussian.scene import Camera

MIN_REFINE = 30
"""Fewest matches near their epipolar lines that a refinement of the pose is based on."""

GATE = 0.02
"""Distance to the epipolar line, as a share of the image diagonal, beyond which the given pose
rules a match out: 0.02 forgives about one degree of rotation at common focal lengths."""

PRIOR_ROTATION = np.radians(0.3)
PRIOR_DIRECTION = np.radians(5.0)
"""Standard deviations of a given relative pose that the refinement assumes. The direction of a
short baseline is the least certain part of it."""


@dataclass(frozen=True, eq=False)
class Relative:
    """How a reference view's pixels at some inverse depth land in a source view.

    ``X_source = R @ X_reference + t`` in camera coordinates (OpenCV axes), ``t`` in scene units.
    """

    K_ref: np.ndarray
    K_src: np.ndarray
    R: np.ndarray
    t: np.ndarray

    @staticmethod
    def between(reference: Camera, source: Camera) -> Relative:
        """The relative geometry that two cameras in one world state."""
        pose = source.w2c @ reference.c2w
        return Relative(reference.K, source.K, pose[:3, :3], pose[:3, 3])

    def reversed(self) -> Relative:
        """The same geometry with the two views' parts exchanged."""
        return Relative(self.K_src, self.K_ref, self.R.T, -self.R.T @ self.t)

    @property
    def infinity(self) -> np.ndarray:
        """Homography [3, 3] of points at infinity, reference pixels to source pixels."""
        return self.K_src @ self.R @ np.linalg.inv(self.K_ref)

    @property
    def epipole(self) -> np.ndarray:
        """Homogeneous shift [3] a pixel gets in the source per unit of inverse depth."""
        return self.K_src @ self.t

    def project(
        self, pixels: np.ndarray, inverse_depth: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Source pixels [..., 2] and z over z [...] of reference pixels [..., 2].

        The second result is the depth in the source divided by that in the reference; where it is
        not positive the point is behind the source and its pixel means nothing.
        """
        w = np.asarray(inverse_depth, np.float64)[..., None]
        a = pixels @ self.infinity[:, :2].T + self.infinity[:, 2] + w * self.epipole
        ratio = a[..., 2]
        return a[..., :2] / np.where(np.abs(ratio) > 1e-9, ratio, 1e-9)[..., None], ratio

    def fundamental(self) -> np.ndarray:
        """F [3, 3] with ``p_source.T @ F @ p_reference = 0`` (Hartley and Zisserman, ch. 9)."""
        x, y, z = self.t / np.linalg.norm(self.t)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.linalg.inv(self.K_src).T @ cross @ self.R @ np.linalg.inv(self.K_ref)

    def epipolar_distance(self, ref: np.ndarray, src: np.ndarray) -> np.ndarray:
        """Signed Sampson distance [M] in pixels of matches [M, 2] and [M, 2]."""
        F = self.fundamental()
        a = np.concatenate([ref, np.ones((len(ref), 1))], 1)
        b = np.concatenate([src, np.ones((len(src), 1))], 1)
        Fa, Fb = a @ F.T, b @ F
        scale = np.sqrt((Fa[:, :2] ** 2).sum(1) + (Fb[:, :2] ** 2).sum(1))
        return (b * Fa).sum(1) / np.maximum(scale, 1e-12)

    def parallax(self, ref: np.ndarray) -> np.ndarray:
        """Pixels [M] that reference pixels [M, 2] move in the source per unit of inverse depth.

        Exact for distant points.
        """
        far, ratio = self.project(ref, 0.0)
        e = self.epipole
        return np.linalg.norm(e[:2] - far * e[2], axis=-1) / np.abs(ratio)

    def triangulate(self, ref: np.ndarray, src: np.ndarray) -> np.ndarray:
        """Inverse depths [M] in the reference that explain matches best; may be negative."""
        a = ref @ self.infinity[:, :2].T + self.infinity[:, 2]
        e = self.epipole
        slope = e[:2] - src * e[2]
        wanted = src * a[:, 2:] - a[:, :2]
        return (slope * wanted).sum(1) / np.maximum((slope**2).sum(1), 1e-12)


def sift_matches(ref: np.ndarray, src: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mutual SIFT matches (Lowe 2004, ratio 0.8) of two grey uint8 images.

    Returns
    -------
    float64 [M, 2], float64 [M, 2]
        Pixels in each image, pixel centres at +0.5; read-only, as who asks again for the same two
        images gets the same arrays.
    """
    return _sift_matches(_Grey(ref), _Grey(src))


@dataclass(frozen=True, eq=False)
class _Grey:
    """An image that is equal to another of the same content."""

    pixels: np.ndarray

    @cached_property
    def content(self) -> tuple[tuple[int, ...], bytes]:
        return self.pixels.shape, hashlib.sha256(np.ascontiguousarray(self.pixels).data).digest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Grey) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)


@lru_cache(maxsize=4)  # the cameras are checked by what depth is found from later
def _sift_matches(first: _Grey, second: _Grey) -> tuple[np.ndarray, np.ndarray]:
    ref, src = first.pixels, second.pixels
    sift = cv2.SIFT_create(nfeatures=4000, contrastThreshold=0.02)
    found = [sift.detectAndCompute(image, None) for image in (ref, src)]
    none = np.zeros((0, 2)), np.zeros((0, 2))
    if any(descriptors is None or len(descriptors) < 2 for _, descriptors in found):
        return none
    (points_a, a), (points_b, b) = found
    # RootSIFT (Arandjelovic and Zisserman 2012): unit vectors, so products rank as distances do.
    a, b = (np.sqrt(d / np.maximum(d.sum(1, keepdims=True), 1e-9)) for d in (a, b))
    similarity = a @ b.T
    best, back = similarity.argmax(1), similarity.argmax(0)
    top = np.partition(similarity, -2, axis=1)[:, -2:]
    nearest, next_nearest = (np.sqrt(np.maximum(2 - 2 * top[:, k], 0)) for k in (1, 0))
    keep = (back[best] == np.arange(len(a))) & (nearest < 0.8 * next_nearest)
    if not keep.any():
        return none
    # OpenCV counts pixel centres at 0.
    xy_a = np.array([p.pt for p in points_a])[keep] + 0.5
    xy_b = np.array([p.pt for p in points_b])[best[keep]] + 0.5
    for xy in (xy_a, xy_b):
        xy.setflags(write=False)
    return xy_a, xy_b


def refine(given: Relative, ref: np.ndarray, src: np.ndarray) -> Relative:
    """Adjust rotation and direction of translation so that matches meet their epipolar lines.

    Robust least squares of the Sampson distance with the given pose as a prior; the length of the
    baseline is kept, and with fewer than :data:`MIN_REFINE` matches so is the pose. Serves
    matching; :func:`slgaussian.predict.fuse.meet` then gives all views the refined poses.
    """
    if len(ref) < MIN_REFINE:
        return given
    length = np.linalg.norm(given.t)
    direction = given.t / length
    # Two axes across the direction of translation.
    across = np.linalg.svd(direction[None])[2][1:]

    def moved(step: np.ndarray) -> Relative:
        turned = direction + step[3:] @ across
        R = cv2.Rodrigues(step[:3])[0] @ given.R
        return replace(given, R=R, t=turned * (length / np.linalg.norm(turned)))

    deviation = np.repeat([PRIOR_ROTATION, PRIOR_DIRECTION], [3, 2])

    def residuals(step: np.ndarray) -> np.ndarray:
        return np.concatenate([moved(step).epipolar_distance(ref, src), step / deviation])

    fit = least_squares(
        residuals, np.zeros(5), loss="cauchy", f_scale=0.5, x_scale=deviation, max_nfev=30
    )
    return moved(fit.x)
