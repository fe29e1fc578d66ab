"""Relative geometry of two views: projection of the points of one view into the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slgaussian.scene import Camera


def transform(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Multiply points [..., M] by a matrix [K, M], giving [..., K], bitwise equal on any CPU.

    BLAS sums in an order that depends on the CPU, and the last bit can change which points match.
    """
    return np.einsum("...j,kj->...k", points, matrix)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply matrices [N, M] and [M, K], giving [N, K], as reproducibly as :func:`transform`."""
    return np.einsum("ij,jk->ik", a, b)


@dataclass(frozen=True, eq=False)
class Relative:
    """Projection of pixels of a reference view, at an inverse depth, into a source view.

    ``X_source = R @ X_reference + t`` in camera coordinates (OpenCV axes), ``t`` in scene units.
    """

    K_ref: np.ndarray
    K_src: np.ndarray
    R: np.ndarray
    t: np.ndarray

    @staticmethod
    def between(reference: Camera, source: Camera) -> Relative:
        """Compute the relative geometry of two cameras in one world frame."""
        turn = source.c2w[:3, :3].T
        # Cameras at one position have t = 0 exactly, whatever the origin.
        t = transform(reference.center - source.center, turn)
        return Relative(reference.K, source.K, product(turn, reference.c2w[:3, :3]), t)

    def reverse(self) -> Relative:
        """Return the geometry with reference and source exchanged."""
        return Relative(self.K_src, self.K_ref, self.R.T, -transform(self.t, self.R.T))

    @cached_property
    def infinity(self) -> np.ndarray:
        """The homography [3, 3] of points at infinity, reference to source pixels."""
        return product(product(self.K_src, self.R), np.linalg.inv(self.K_ref))

    @cached_property
    def epipole(self) -> np.ndarray:
        """The homogeneous shift [3] of a pixel in the source per unit of inverse depth."""
        return transform(self.t, self.K_src)

    def project(
        self, pixels: np.ndarray, inverse_depth: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return source pixels [..., 2] and depth ratios [...] of reference pixels [..., 2].

        The ratio is the depth in the source divided by that in the reference; if it is not positive
        the point is behind the source and its pixel is meaningless.
        """
        w = np.asarray(inverse_depth, np.float64)[..., None]
        infinity = self.infinity
        a = transform(pixels, infinity[:, :2]) + infinity[:, 2] + w * self.epipole
        ratio = a[..., 2]
        return a[..., :2] / np.where(np.abs(ratio) > 1e-9, ratio, 1e-9)[..., None], ratio

    def fundamental(self) -> np.ndarray:
        """Return F [3, 3], ``p_source.T @ F @ p_reference = 0`` (Hartley and Zisserman, ch. 9)."""
        x, y, z = self.t / np.linalg.norm(self.t)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        between = product(product(np.linalg.inv(self.K_src).T, cross), self.R)
        return product(between, np.linalg.inv(self.K_ref))

    def epipolar_distance(self, ref: np.ndarray, src: np.ndarray) -> np.ndarray:
        """Compute the signed Sampson distance [M] in pixels of matches [M, 2] and [M, 2]."""
        F = self.fundamental()
        a = np.concatenate([ref, np.ones((len(ref), 1))], 1)
        b = np.concatenate([src, np.ones((len(src), 1))], 1)
        Fa, Fb = transform(a, F), transform(b, F.T)
        scale = np.sqrt((Fa[:, :2] ** 2).sum(1) + (Fb[:, :2] ** 2).sum(1))
        return (b * Fa).sum(1) / np.maximum(scale, 1e-12)

    def parallax(self, ref: np.ndarray) -> np.ndarray:
        """Compute the shift [M], source pixels per unit inverse depth, of reference pixels [M, 2].

        Exact for distant points.
        """
        far, ratio = self.project(ref, 0.0)
        e = self.epipole
        return np.linalg.norm(e[:2] - far * e[2], axis=-1) / np.abs(ratio)

    def triangulate(self, ref: np.ndarray, src: np.ndarray) -> np.ndarray:
        """Compute the best inverse depths [M] of matches in the reference; may be negative."""
        infinity = self.infinity
        a = transform(ref, infinity[:, :2]) + infinity[:, 2]
        e = self.epipole
        slope = e[:2] - src * e[2]
        offset = src * a[:, 2:] - a[:, :2]
        return (slope * offset).sum(1) / np.maximum((slope**2).sum(1), np.finfo(float).tiny)
