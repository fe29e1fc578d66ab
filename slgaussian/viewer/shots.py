"""Pictures to keep of what a session shows: one, or a short turn."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from slgaussian.benchmark.pictures import encode_png
from slgaussian.cameras.trajectories import orbit
from slgaussian.scene import Camera
from slgaussian.viewer.session import Session

FRAMES = 30
RATE = 15
"""Frames a second."""

SIDE = 480
"""Longer side of a frame of a turn: a GIF is large."""

REACH = 0.04
"""How far a turn goes to each side, as a share of the distance to what is looked at."""


def picture(session: Session, camera: Camera) -> bytes:
    """PNG of what is shown, as ``camera`` sees it."""
    return encode_png(session.picture(camera))


def turn(session: Session, camera: Camera) -> bytes:
    """GIF of a short turn about what ``camera`` looks at, in a loop.

    Raises
    ------
    InputError
        If nothing lies before the camera.
    """
    share = min(1.0, SIDE / max(camera.width, camera.height))
    small = camera.resized(round(camera.width * share), round(camera.height * share))
    points = session.gaussians.means.numpy()
    pixels, z = small.project(points.astype(np.float64))
    inside = (z > 0) & (pixels >= 0).all(1) & (pixels < (small.width, small.height)).all(1)
    reach = REACH * float(np.median(z[inside])) if inside.any() else 1.0
    sides = []
    for sign in (-1, 1):
        c2w = small.c2w.copy()
        c2w[:3, 3] += sign * reach * c2w[:3, 0]
        sides.append(replace(small, c2w=c2w))
    frames = [
        Image.fromarray(session.picture(place)).quantize(256)
        for place in orbit(sides, points, FRAMES)
    ]
    out = io.BytesIO()
    first, *others = frames
    first.save(out, "GIF", save_all=True, append_images=others, duration=round(1000 / RATE), loop=0)
    return out.getvalue()
