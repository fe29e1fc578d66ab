"""The relative geometry of two views: where the points of one land in the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slgaussian.scene import Camera


def mapped(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points [..., M] after a matrix [K, M], [..., K]: the same on any processor.

    BLAS adds up in an order of its own on each, and a last digit here can tip what is matched.
    """
    return np.einsum("...j,kj->...k", points, matrix)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The product [N, K] of matrices [N, M] and [M, K], likewise."""
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
        """The relative geometry that two cameras in one world state."""
        turn = source.c2w[:3, :3].T
        # Of one place exactly none, wherever the origin is.
        t = mapped(reference.center - source.center, turn)
        return Relative(reference.K, source.K, product(turn, reference.c2w[:3, :3]), t)

    def reversed(self) -> Relative:
        """The same geometry with the two views' parts exchanged."""
        return Relative(self.K_src, self.K_ref, self.R.T, -mapped(self.t, self.R.T))

    @property
    def infinity(self) -> np.ndarray:
        """Homography [3, 3] of points at infinity, reference pixels to source pixels."""
        return product(product(self.K_src, self.R), np.linalg.inv(self.K_ref))

    @property
    def epipole(self) -> np.ndarray:
        """Homogeneous shift [3] a pixel gets in the source per unit of inverse depth."""
        return mapped(self.t, self.K_src)

    def project(
        self, pixels: np.ndarray, inverse_depth: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Source pixels [..., 2] and z over z [...] of reference pixels [..., 2].

        The second result is the depth in the source divided by that in the reference; where it is
        not positive the point is behind the source and its pixel means nothing.
        """
        w = np.asarray(inverse_depth, np.float64)[..., None]
        infinity = self.infinity
        a = mapped(pixels, infinity[:, :2]) + infinity[:, 2] + w * self.epipole
        ratio = a[..., 2]
        return a[..., :2] / np.where(np.abs(ratio) > 1e-9, ratio, 1e-9)[..., None], ratio

    def fundamental(self) -> np.ndarray:
        """F [3, 3] with ``p_source.T @ F @ p_reference = 0`` (Hartley and Zisserman, ch. 9)."""
        x, y, z = self.t / np.linalg.norm(self.t)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        between = product(product(np.linalg.inv(self.K_src).T, cross), self.R)
        return product(between, np.linalg.inv(self.K_ref))

    def epipolar_distance(self, ref: np.ndarray, src: np.ndarray) -> np.ndarray:
        """Signed Sampson distance [M] in pixels of matches [M, 2] and [M, 2]."""
        F = self.fundamental()
        a = np.concatenate([ref, np.ones((len(ref), 1))], 1)
        b = np.concatenate([src, np.ones((len(src), 1))], 1)
        Fa, Fb = mapped(a, F), mapped(b, F.T)
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
        infinity = self.infinity
        a = mapped(ref, infinity[:, :2]) + infinity[:, 2]
        e = self.epipole
        slope = e[:2] - src * e[2]
        wanted = src * a[:, 2:] - a[:, :2]
        return (slope * wanted).sum(1) / np.maximum((slope**2).sum(1), 1e-12)
