"""Cameras from photographs and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slgaussian.cameras.found import DOUBTFUL, UNUSED, Focal, FoundCameras
from slgaussian.cameras.many import Many, find_many
from slgaussian.cameras.pair import EXIF_SPREAD, SPREAD, Described, PairPose, confidence, find_pair
from slgaussian.cameras.photograph import Photograph
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Estimated

WITHIN = 1.645
"""Deviations on either side of a normal distribution's middle that hold nine tenths of it."""

OPTIMISM, MODEL = 2.0, 0.03
"""Matches err in more ways than the loss knows, and no lens is a pinhole: the deviation of a focal
length's logarithm is so many times what the matches say, and that in quadrature. Chosen so that
nine in ten true ones of the answered pairs of `docs/measured/poses.md` lie in the interval."""

SURE = 0.8
DOUBTED = "these cameras are doubtful: some photographs share little with the others"
"""What is said of three and more below that confidence."""

TOLD = 0.8
"""Matches have told a focal length if they narrow it down to less than this part of what is usual.
"""


def find_cameras(photographs: Sequence[Photograph]) -> FoundCameras:
    """The cameras of two or more photographs.

    The same photographs give the same cameras; their order decides only about the frame.

    Raises
    ------
    InputError
        If they cannot be found; the message says of which photographs, why, and what to do.
    """
    described = [Described.of(photograph) for photograph in photographs]
    if len(described) > 2:
        return _many_cameras(find_many(described), photographs)
    order = sorted(range(len(described)), key=lambda k: described[k].digest)
    a, b = (described[k] for k in order[:2])
    pose = find_pair(a, b)
    if pose.found.verdict == UNUSED or pose.views is None:
        first, second = (photograph.name for photograph in photographs)
        raise InputError(
            f"{first!r} and {second!r}: no cameras can be found: {pose.found.said}; {pose.advice}"
        )
    return _pair_cameras(pose, photographs)


def _pair_cameras(pose: PairPose, photographs: Sequence[Photograph]) -> FoundCameras:
    assert pose.views is not None and pose.views.covariance is not None
    views, covariance, sure = pose.views, pose.views.covariance, confidence(pose)
    there = np.eye(4)
    there[:3, :3], there[:3, 3] = views.R, views.t
    c2w = {pose.first.photograph.name: np.eye(4), pose.second.photograph.name: np.linalg.inv(there)}
    z = views.depths(pose.x, pose.y)[0]
    points = np.concatenate([pose.x / views.focals[0], np.ones((len(z), 1))], 1) * z[:, None]
    world = c2w[photographs[0].name]
    w2world = np.linalg.inv(world)
    deviations = np.sqrt(np.diag(covariance)[5:])
    cameras, focals = {}, {}
    by_name = {
        p.photograph.name: (p, f)
        for p, f in zip((pose.first, pose.second), views.focals, strict=True)
    }
    for photograph in photographs:
        described, pixels = by_name[photograph.name]
        _, sigma = described.focal
        own = 0 if len(deviations) < 2 else [pose.first, pose.second].index(described)
        focals[photograph.name] = focal_of(
            pixels / described.shrunk,
            sigma * float(deviations[own]) if len(deviations) else 0.0,
            photograph,
        )
    for photograph in photographs:
        cameras[photograph.name] = camera_of(
            photograph, focals[photograph.name], w2world @ c2w[photograph.name], sure
        )
    cameras = with_up(cameras, photographs)
    warned = (
        (f"these cameras are doubtful: {pose.found.said}",)
        if pose.found.verdict == DOUBTFUL
        else ()
    )
    named = replace(pose.found, views=(photographs[0].name, photographs[1].name))
    return FoundCameras(
        cameras,
        focals,
        dict.fromkeys(cameras, 0.0),
        (named,),
        points @ w2world[:3, :3].T + w2world[:3, 3],
        sure,
        warned,
    )


def _many_cameras(many: Many, photographs: Sequence[Photograph]) -> FoundCameras:
    cameras, focals = {}, {}
    shown = [max(p.image.shape[:2]) / max(p.width, p.height) for p in photographs]
    for k, photograph in enumerate(photographs):
        pixels, deviation = float(many.focals[k] / shown[k]), float(many.deviations[k])
        focals[photograph.name] = focal_of(pixels, deviation, photograph)
        c2w = np.eye(4)
        c2w[:3, :3], c2w[:3, 3] = many.R[k].T, -many.R[k].T @ many.t[k]
        cameras[photograph.name] = camera_of(
            photograph, focals[photograph.name], c2w, many.confidence
        )
    warned = (DOUBTED,) if many.confidence < SURE else ()
    return FoundCameras(
        with_up(cameras, photographs),
        focals,
        {p.name: float(k1) for p, k1 in zip(photographs, many.k1, strict=True)},
        many.pairs,
        many.points,
        many.confidence,
        warned,
    )


def focal_of(pixels: float, deviation: float, photograph: Photograph) -> Focal:
    """A focal length of the whole photograph with its interval, from the deviation of its
    logarithm."""
    known = EXIF_SPREAD if photograph.focal is not None else SPREAD
    deviation = min(float(np.hypot(OPTIMISM * deviation, MODEL)), known)
    wide = float(np.exp(WITHIN * deviation))
    if photograph.focal is not None:
        source = "EXIF"
    else:
        source = "matches" if deviation < TOLD * SPREAD else "guess"
    return Focal(float(pixels), float(pixels / wide), float(pixels * wide), source)


def camera_of(photograph: Photograph, focal: Focal, c2w: np.ndarray, sure: float) -> Camera:
    """The camera of a whole photograph, its principal point in the middle."""
    f, width, height = focal.pixels, photograph.width, photograph.height
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    said = Estimated((focal.low / f, focal.high / f), focal.source, sure)
    return Camera(K, c2w, width, height, estimated=said)


def with_up(cameras: dict[str, Camera], photographs: Sequence[Photograph]) -> dict[str, Camera]:
    """The cameras with the world's up, where phones measured it: the mean of what they say."""
    said = [cameras[p.name].c2w[:3, :3] @ p.up for p in photographs if p.up is not None]
    total = np.sum(said, axis=0) if said else np.zeros(3)
    length = np.linalg.norm(total)
    if length < 0.5 * max(len(said), 1):  # none, or they contradict each other
        return cameras
    x, y, z = (total / length).tolist()
    return {
        name: replace(camera, estimated=replace(camera.estimated, up=(x, y, z)))
        for name, camera in cameras.items()
        if camera.estimated is not None
    }
