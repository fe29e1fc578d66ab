"""Views of clips: their common size, their samples, and the rows of spec ``views``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slgaussian.copies import signature
from slgaussian.datasets import re10k
from slgaussian.datasets.near_copies import SIGNATURE_SIDE
from slgaussian.datasets.pair_selection import Views
from slgaussian.datasets.sharpness import blur, exposure, glance
from slgaussian.errors import InputError
from slgaussian.formats.resampling import Window
from slgaussian.predict.distance import typical_depths
from slgaussian.scene import Sample, View

CAMERA_COLUMNS = ("fx", "fy", "cx", "cy", *(f"w2c_{r}{c}" for r in range(3) for c in range(4)))
"""Columns of a camera in the table: a row of a chunk without its two zeros."""


@dataclass(frozen=True)
class Framing:
    """Common size and depth range of the views of a chunk.

    Attributes:
        size: (height, width)
        near, far: Depth range along z in scene units; estimated from the views if None.
    """

    size: tuple[int, int]
    near: float | None = None
    far: float | None = None

    def read(self, clip: re10k.Clip, frames: Sequence[int]) -> tuple[View, ...]:
        """Decode and resize frames of a clip; InputError if one cannot be decoded."""
        views = [clip.view(frame).resize(*self.size) for frame in frames]
        return tuple(replace(v, camera=v.camera.with_range(self.near, self.far)) for v in views)

    def read_sample(self, clip: re10k.Clip, row: Mapping[str, Any], targets: bool) -> Sample:
        """Read the sample of a row of spec ``pairs``.

        Decoding ``targets`` takes as long as the context and is optional.

        Raises:
            InputError: If a view cannot be decoded, or the views do not make a sample, or a
                target is a copy of a context view.
        """
        context = self.read(clip, row["context"])
        sample = Sample(row["sample"], context, self.read(clip, row["targets"] if targets else ()))
        sample.check_held_out()
        return sample


def describe_views(clip: re10k.Clip) -> tuple[list[dict[str, Any]], list[InputError]]:
    """Compute the rows of spec ``views`` of a clip, and the errors of frames that are left out."""
    rows, errors, greys, cameras = [], [], [], []
    for frame, (data, numbers) in enumerate(zip(clip.images, clip.cameras, strict=True)):
        try:
            grey, (width, height) = glance(data)
            camera, opaque = re10k.camera_from_row(numbers, width, height), clip.opaque(frame)
            shown = grey
            if opaque is not None:
                shown = grey[Window.whole(width, height).mask(opaque, *grey.shape)]
            if not shown.size:
                raise InputError("it is transparent everywhere")
        except InputError as error:
            errors.append(InputError(f"clip {clip.key!r}, frame {frame}: {error}"))
            continue
        mean, clipped = exposure(shown)
        greys.append(grey)
        cameras.append(camera.resize(*grey.shape[::-1]))
        rows.append(
            {
                "clip": clip.key,
                "video": clip.url,
                "frame": frame,
                "timestamp": int(clip.timestamps[frame]),
                "digest": hashlib.sha256(data).hexdigest(),
                "signature": signature(grey, SIGNATURE_SIDE).astype(np.uint8).tobytes().hex(),
                "width": width,
                "height": height,
                **dict(zip(CAMERA_COLUMNS, np.delete(numbers, (4, 5)).tolist(), strict=True)),
                "blur": blur(grey),
                "mean": mean,
                "clipped": clipped,
            }
        )
    for row, depth in zip(rows, typical_depths(greys, cameras).tolist(), strict=True):
        row["depth"] = None if np.isnan(depth) else depth
    return rows, errors


def known_views(views: Sequence[Mapping[str, Any]]) -> Views:
    """Convert rows of spec ``views`` of one clip to :class:`Views`."""

    def column(name: str) -> np.ndarray:
        return np.array([view[name] for view in views], np.float64)

    numbers = np.insert(
        [[view[name] for name in CAMERA_COLUMNS] for view in views], (4, 4), 0, axis=1
    )
    cameras = [
        re10k.camera_from_row(row, view["width"], view["height"])
        for row, view in zip(numbers, views, strict=True)
    ]
    return Views(cameras, column("depth"), column("blur"), column("mean"), column("clipped"))
