"""What makes a scene of several photographs hard, and the easy scenes that it is done to.

A twist is given context views, and gives others of the same scene, so that both can be asked for
the same pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from slgaussian import datasets
from slgaussian.datasets.procedural.raycast import BOX, Solid
from slgaussian.predict.pose_refinement import with_pose
from slgaussian.scene import Camera, Sample, View
from tests.predict.hard_pairs import PHOTO_WALL, camera, photograph

ELSEWHERE = 1000
"""So many seeds away is the room that a stranger shows."""

GAIN = 0.7
TINT = (1.3, 1.0, 0.75)
"""Light of the photograph that has another exposure, and of the one with another white balance."""

QUALITY = 85
"""Of the JPEG that a photograph is saved as once more."""

Views = tuple[View, ...]


def arc(seed: int, number: int, size: tuple[int, int], length: float = 1.0) -> Sample:
    """A made-up room from ``number`` places of an arc; a target is in every second gap."""
    height, width = size
    scene = datasets.load(
        "procedural", seed, views=2 * number - 1, baseline=length, height=height, width=width
    )
    names = list(scene.cameras)
    return scene.sample(names[::2], names[1::4])


def changed(views: Views, place: int, view: View) -> Views:
    """The views with another at a place."""
    return (*views[:place], view, *views[place + 1 :])


def exposed(view: View, gain: float | tuple[float, float, float]) -> View:
    """The view with so many times the light; red, green and blue may differ."""
    srgb = view.image / 255
    light = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    light = (light * gain).clip(0, 1)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return replace(view, image=np.round(srgb * 255).astype(np.uint8))


def saved_again(view: View) -> View:
    """The view as a JPEG of it looks, by another name."""
    coded = cv2.imencode(".jpg", view.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    image = np.ascontiguousarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1])
    return replace(view, name="saved again", image=image)


def stranger(seed: int, inputs: Sample, place: int) -> View:
    """What a photograph of another room looks like, with a camera between two of this one's."""
    a, b = (view.camera for view in inputs.context[place : place + 2])
    size = (a.height, a.width)
    second = arc(seed + ELSEWHERE, len(inputs.context), size).context[place]
    between = with_pose(a, a.c2w[:3, :3], (2 * a.center + b.center) / 3)
    return replace(second, name="stranger", camera=between, depth=None, instances=None)


def quarter_turned(view: View) -> View:
    """The view as a camera takes it that is held turned by 90 degrees, clockwise."""
    observed = view.camera
    (fx, _, cx), (_, fy, cy), _ = observed.K
    K = np.array([[fy, 0, cy], [0, fx, observed.width - cx], [0, 0, 1]])
    c2w = observed.c2w.copy()
    c2w[:3, 0], c2w[:3, 1] = observed.c2w[:3, 1], -observed.c2w[:3, 0]

    def turn(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else np.ascontiguousarray(np.rot90(values))

    image = turn(view.image)
    assert image is not None
    return replace(
        view,
        camera=replace(observed, K=K, c2w=c2w, width=observed.height, height=observed.width),
        image=image,
        depth=turn(view.depth),
        instances=turn(view.instances),
    )


def rolling(views: Sequence[View]) -> Views:
    """Each view turned by a quarter more than the one before it."""
    result = []
    for k, view in enumerate(views):
        for _ in range(k % 4):
            view = quarter_turned(view)
        result.append(view)
    return tuple(result)


def shuffled(views: Sequence[View], seed: int) -> Views:
    """The views in a random order."""
    return tuple(views[k] for k in np.random.default_rng(seed).permutation(len(views)))


# A walk round inside a room, looking outward, that comes back to where it began.

RADIUS = 0.6
FRONT = (PHOTO_WALL, Solid(BOX, (3.5, 0.1, 1.6), (0, -5.0, 1.6)))
"""The wall behind the cameras, which the stage of hard pairs has not."""


def loop(number: int) -> Sample:
    """So many views of a way round, with targets between the last and the first, and opposite."""
    return Sample(
        "loop",
        tuple(photograph(f"view{k}", _round(k / number), extra=[FRONT]) for k in range(number)),
        tuple(
            photograph(f"target{k}", _round(k / number), extra=[FRONT])
            for k in (number - 0.5, number / 2 - 0.5)
        ),
    )


def _round(part: float) -> Camera:
    angle = 2 * np.pi * part
    right, forward = RADIUS * np.sin(angle), RADIUS * np.cos(angle)
    return camera(right=right, forward=forward, yaw=float(np.degrees(angle)), focal=90)
