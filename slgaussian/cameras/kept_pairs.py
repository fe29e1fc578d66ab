"""Relative poses of pairs of photographs, each solved once where results are kept."""

from __future__ import annotations

import hashlib

import numpy as np

from slgaussian.cameras.epipolar import TwoViews
from slgaussian.cameras.found import FoundPair
from slgaussian.cameras.pair import Described, PairPose, find_pair
from slgaussian.kernels.seeding import content_of
from slgaussian.storage.derived import Arrays, once

OF_POINTS = ("i", "j", "x", "y")
OF_VIEWS = ("R", "t", "focals", "moves", "cost", "scale")


def pair_pose(a: Described, b: Described) -> PairPose:
    """As :func:`slgaussian.cameras.pair.find_pair`; kept as :mod:`slgaussian.storage.derived` says.

    Names play no part.
    """

    def content() -> str:
        images = content_of(a.photograph.image, b.photograph.image)
        known = f"{images} {a.lens!r} {a.shrunk!r} {b.lens!r} {b.shrunk!r}"
        return hashlib.sha256(known.encode()).hexdigest()

    kept = once("relative poses", 1, content, lambda: to_arrays(find_pair(a, b)))
    return from_arrays(kept, a, b)


def to_arrays(pose: PairPose) -> Arrays:
    """What a pose holds beside its photographs."""
    found, views = pose.found, pose.views
    arrays = {name: getattr(pose, name) for name in OF_POINTS}
    arrays["counts"] = np.array([found.matches, found.inliers])
    arrays["numbers"] = np.array([found.angle, found.uncertainty, pose.probability])
    arrays["words"] = np.array([found.verdict, found.said, pose.advice])
    if views is not None:
        arrays |= {name: np.asarray(getattr(views, name)) for name in OF_VIEWS}
        if views.covariance is not None:
            arrays["covariance"] = views.covariance
    return arrays


def from_arrays(arrays: Arrays, a: Described, b: Described) -> PairPose:
    """Inverse of :func:`to_arrays`, of the same photographs."""
    views = None
    if "R" in arrays:
        R, t, focals, moves, cost, scale = (arrays[name] for name in OF_VIEWS)
        covariance = arrays.get("covariance")
        views = TwoViews(R, t, focals, moves, float(cost), float(scale), covariance)
    matches, inliers = arrays["counts"].tolist()
    angle, uncertainty, probability = arrays["numbers"].tolist()
    verdict, said, advice = arrays["words"].tolist()
    names = a.photograph.name, b.photograph.name
    found = FoundPair(names, matches, inliers, angle, uncertainty, verdict, said)
    i, j, x, y = (arrays[name] for name in OF_POINTS)
    return PairPose(a, b, views, i, j, x, y, found, advice, probability)
