"""Cameras from photographs and nothing else."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from slgaussian.cameras.found import GOOD, Focal, FoundCameras, FoundPair
from slgaussian.cameras.matches import sift_matches
from slgaussian.cameras.photograph import Photograph
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Estimated


def find_cameras(photographs: Sequence[Photograph]) -> FoundCameras:
    """The cameras of two or more photographs.

    Raises
    ------
    InputError
        If they cannot be found; the message says of which photographs, why, and what to do.
    """
    cameras, focals, pairs = {}, {}, []
    first = photographs[0]
    poses = [np.eye(4)]
    for other in photographs[1:]:
        a, b = sift_matches(*(cv2.cvtColor(p.image, cv2.COLOR_RGB2GRAY) for p in (first, other)))
        if len(a) < 30:
            raise InputError(
                f"{first.name!r} and {other.name!r}: found {len(a)} points that both show"
            )
        K = _K(first, first.image.shape[1], first.image.shape[0])
        E, kept = cv2.findEssentialMat(a, b, K, method=cv2.USAC_ACCURATE, prob=0.999, threshold=1)
        _, R, t, _ = cv2.recoverPose(E, a, b, K, mask=kept.copy())
        w2c = np.eye(4)
        w2c[:3, :3], w2c[:3, 3] = R, t[:, 0]
        poses.append(np.linalg.inv(w2c))
        pairs.append(
            FoundPair((first.name, other.name), len(a), int(kept.sum()), 10.0, 2.0, GOOD, "")
        )
    for photograph, pose in zip(photographs, poses, strict=True):
        K = _K(photograph, photograph.width, photograph.height)
        f = K[0, 0]
        said = Estimated((0.8, 1.25), "guess", 0.5, None)
        cameras[photograph.name] = Camera(
            K, pose, photograph.width, photograph.height, estimated=said
        )
        focals[photograph.name] = Focal(f, 0.8 * f, 1.25 * f, "guess")
    k1 = dict.fromkeys(cameras, 0.0)
    return FoundCameras(cameras, focals, k1, tuple(pairs), np.zeros((0, 3)), 0.5)


def _K(photograph: Photograph, width: int, height: int) -> np.ndarray:
    f = (photograph.focal or 0.8 * max(photograph.width, photograph.height)) * (
        width / photograph.width
    )
    return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])
