"""What is seen in photographs once their depth is predicted, each thing derived once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.geometry.boundaries import boundary_map, texture_codes
from slgaussian.geometry.room import Room, Surroundings, find_room
from slgaussian.io import short_repr
from slgaussian.scene import Camera, View

CONFIRMS = 0.02
"""Two views show one surface where their depths differ by at most this fraction."""

CLASHES = 15.0
SMOOTH = 2.0
"""Distance in CIELAB from which colours of one surface in two views contradict each other, and the
deviation of the Gaussian that they are smoothed by, pixels."""


@dataclass(frozen=True, eq=False)
class SeenView:
    """A photograph with its predicted depth, as proposers and trackers look at it.

    What several of them need, of the photograph (:attr:`slgaussian.scene.View.lab` and ``grey``)
    and of both, is computed when it is first asked for, and kept.

    Attributes
    ----------
    view : View
        Its truths must not be read.
    depth : float32 [H, W] or None
        Predicted z-depth in scene units, 0 where unknown. None if there is none at all.
    """

    view: View
    depth: np.ndarray | None = None

    __repr__ = short_repr

    def require_depth(self) -> np.ndarray:
        """The depth; InputError if there is none."""
        if self.depth is None:
            raise InputError(f"view {self.view.name!r}: found no predicted depth, expected one")
        return self.depth

    @staticmethod
    def alone(image: np.ndarray, depth: np.ndarray | None = None) -> SeenView:
        """A photograph by itself, for what needs no camera.

        Raises
        ------
        InputError
            Unless the image is uint8 [H, W, 3] with at least one pixel.
        """
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
            raise InputError(
                f"image: found {image.dtype} {image.shape}, expected uint8 [H, W, 3] RGB"
            )
        height, width = image.shape[:2]
        anywhere = Camera(np.diag([width, width, 1.0]), np.eye(4), width, height)
        return SeenView(View("photograph", anywhere, image), depth)

    @property
    def image(self) -> np.ndarray:
        """The photograph, uint8 [H, W, 3]."""
        return self.view.image

    @cached_property
    def texture(self) -> np.ndarray:
        """Texture code of every pixel; see :func:`texture_codes`."""
        return texture_codes(self.view.lab[..., 0])

    @cached_property
    def boundary(self) -> np.ndarray:
        """Strength of borders between things; see :func:`boundary_map`."""
        return boundary_map(self.view.lab, self.depth)


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """The context views of a sample and the surfaces that a predictor found in them.

    Attributes
    ----------
    seen : tuple of V SeenView
        The context views, each with its depth.
    """

    seen: tuple[SeenView, ...]

    __repr__ = short_repr

    @staticmethod
    def of(views: Sequence[View], gaussians: Gaussians) -> SceneGeometry:
        """The geometry of the views that Gaussians were predicted from.

        Depth is that of the Gaussians in the given cameras: a predictor may have moved surfaces and
        cameras after it matched them.
        """
        depths = source_depths(gaussians, [view.camera for view in views])
        return SceneGeometry(
            tuple(SeenView(view, depth) for view, depth in zip(views, depths, strict=True))
        )

    @cached_property
    def views(self) -> tuple[View, ...]:
        """The photographs."""
        return tuple(seen.view for seen in self.seen)

    @cached_property
    def depths(self) -> np.ndarray:
        """Predicted z-depth of every view, float32 [V, H, W] in scene units, 0 where unknown."""
        return np.stack([seen.require_depth() for seen in self.seen])

    def seen_again(self, here: int, there: int) -> tuple[np.ndarray, np.ndarray]:
        """Which surfaces of one view fall inside another, and which that one shows.

        Two bool [H, W] over the pixels of view ``here``.
        """
        camera, depth = self.views[here].camera, self.depths[here]
        other, shown = self.views[there].camera, self.depths[there]
        pixels, z = other.project(camera.unproject(depth))
        inside = (depth > 0) & (z > 0) & (pixels >= 0).all(-1)
        inside &= (pixels < (other.width, other.height)).all(-1)
        u, v = np.where(inside[..., None], pixels, 0).astype(np.int64).transpose(2, 0, 1)
        met = shown[v, u]
        return inside, inside & (met > 0) & (np.abs(z - met) <= CONFIRMS * met)

    def clash(self, here: int, there: int) -> float:
        """Return which share of what one view shows looks different in another that should show it.

        Colours of pixels that fall inside the other view and are not hidden there are compared,
        smoothed and brought to one exposure: where they differ by more than :data:`CLASHES`,
        something moved, or the depth is wrong. 0 if there are no such pixels.
        """
        camera, depth = self.views[here].camera, self.depths[here]
        other, shown = self.views[there].camera, self.depths[there]
        pixels, z = other.project(camera.unproject(depth))
        inside, _ = self.seen_again(here, there)
        at = np.where(inside[..., None], pixels, 0)
        u, v = at.astype(np.float32).transpose(2, 0, 1)
        column, row = at.astype(np.int64).transpose(2, 0, 1)  # float32 may round up to the width
        visible = inside & (z <= (1 + CONFIRMS) * shown[row, column])
        if not visible.any():
            return 0.0
        mine, others = (cv2.GaussianBlur(self.views[i].lab, (0, 0), SMOOTH) for i in (here, there))
        off = (mine - cv2.remap(others, u - 0.5, v - 0.5, cv2.INTER_LINEAR))[visible]
        return float((np.linalg.norm(off - np.median(off, 0), axis=-1) > CLASHES).mean())

    @cached_property
    def room(self) -> Room:
        """Which way is up, and where the floor is."""
        return find_room([view.camera for view in self.views], self.depths)

    @cached_property
    def surroundings(self) -> tuple[Surroundings, ...]:
        """Where the pixels of every view lie in the room."""
        return tuple(
            self.room.place(view.camera, depth)
            for view, depth in zip(self.views, self.depths, strict=True)
        )
