"""Bundles with a known truth: a box of points that several cameras see."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.cameras.bundle import Bundle


def true_bundle(
    views: int,
    points: int,
    seed: int,
    *,
    noise: float = 0.5,
    outliers: float = 0.0,
    turned: float = 0.1,
    baseline: float = 1.0,
    depths: tuple[float, float] = (4.0, 9.0),
    lenses: int = 1,
) -> Bundle:
    """Cameras of 600 px, side by side, and what they see of points in front of them."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_rotvec(rng.normal(0, turned, (views, 3))).as_matrix()
    R[0] = np.eye(3)
    centers = rng.normal(0, 0.5, (views, 3)) * baseline
    centers[0], centers[1] = 0, np.array([1, 0.1, 0.05]) * baseline
    z = rng.uniform(*depths, points)
    xy = rng.uniform(-0.5, 0.5, (points, 2)) * z[:, None]
    view, point = np.nonzero(rng.random((views, points)) < (1.0 if views == 2 else 0.7))
    empty = Bundle(
        R=R,
        t=-(R @ centers[:, :, None])[..., 0],
        centers=np.full((views, 2), [400.0, 300.0]),
        group=np.arange(views) % lenses,
        focals=np.full(lenses, 600.0),
        points=np.column_stack([xy, z]),
        view=view,
        point=point,
        xy=np.zeros((len(view), 2)),
        focal_prior=np.full(lenses, 600.0),
        focal_sigma=np.full(lenses, np.inf),
    )
    seen = reprojection(empty) + rng.normal(0, noise, (len(view), 2))
    bad = rng.random(len(view)) < outliers
    seen[bad] += rng.uniform(-200, 200, (bad.sum(), 2))
    return replace(empty, xy=seen)


def reprojection(bundle: Bundle) -> np.ndarray:
    """Projected minus observed positions [M, 2], pixels, written out."""
    local = (bundle.R[bundle.view] @ bundle.points[bundle.point][:, :, None])[..., 0]
    local += bundle.t[bundle.view]
    focals = bundle.focals[bundle.group[bundle.view]]
    uv = local[:, :2] / local[:, 2:] * focals[:, None]
    return uv + bundle.centers[bundle.view] - bundle.xy


def shaken(bundle: Bundle, seed: int, by: float = 0.02) -> Bundle:
    """The same observations, everything else a little wrong."""
    rng = np.random.default_rng(seed)
    views = len(bundle.R)
    turned = rng.normal(0, by, (views, 3))
    turned[0] = 0
    length = np.linalg.norm(bundle.t[1])
    t = bundle.t + rng.normal(0, by, (views, 3)) * length
    t[0] = 0
    t[1] *= length / np.linalg.norm(t[1])
    free = bundle.focal_sigma > 0
    return replace(
        bundle,
        R=Rotation.from_rotvec(turned).as_matrix() @ bundle.R,
        t=t,
        focals=bundle.focals * np.exp(free * rng.normal(0, 2 * by, len(bundle.focals))),
        points=bundle.points * np.exp(rng.normal(0, by, (len(bundle.points), 1))),
    )
