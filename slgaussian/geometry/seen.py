"""Photographs with predicted depth, and quantities derived from them, each computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.geometry.boundaries import boundary_map, texture_codes
from slgaussian.geometry.room import Room, Surroundings, find_room
from slgaussian.io import short_repr
from slgaussian.rasterize.picture import picture
from slgaussian.scene import Camera, View

DEPTH_TOLERANCE = 0.02
"""Largest relative depth difference at which two views show one surface."""

CLASH_DISTANCE = 15.0
SMOOTHING_STD = 2.0
"""CIELAB distance above which colours of one surface in two views contradict each other, and the
standard deviation of the Gaussian smoothing before comparison, pixels."""


@dataclass(frozen=True, eq=False)
class SeenView:
    """A photograph with predicted depth, the input of mask proposers and trackers.

    Quantities derived from the photograph (:attr:`slgaussian.scene.View.lab` and ``grey``) and the
    depth are computed on first access and cached.

    Attributes:
        view: Its ground truth must not be read.
        depth: float32 [H, W] or None. Predicted z-depth in scene units, 0 where unknown, as where
            the photograph is transparent.
    """

    view: View
    depth: np.ndarray | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        opaque = self.view.opaque
        if self.depth is not None and opaque is not None:
            object.__setattr__(self, "depth", np.where(opaque, self.depth, np.float32(0)))

    def require_depth(self) -> np.ndarray:
        """Return the depth; InputError if there is none."""
        if self.depth is None:
            raise InputError(f"view {self.view.name!r}: found no predicted depth, expected one")
        return self.depth

    @staticmethod
    def alone(image: np.ndarray, depth: np.ndarray | None = None) -> SeenView:
        """Wrap a photograph without a camera.

        Raises:
            InputError: Unless the image is uint8 [H, W, 3] with at least one pixel.
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
        """Photograph, uint8 [H, W, 3]."""
        return self.view.image

    @cached_property
    def texture(self) -> np.ndarray:
        """Texture code of every pixel; see :func:`texture_codes`."""
        return texture_codes(self.view.lab[..., 0])

    @cached_property
    def boundary(self) -> np.ndarray:
        """Boundary strength; see :func:`boundary_map`."""
        return boundary_map(self.view.lab, self.depth)


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """Context views of a sample with the depth of predicted Gaussians.

    Attributes:
        frames: tuple of V SeenView. The context views, each with depth.
    """

    frames: tuple[SeenView, ...]

    __repr__ = short_repr

    @staticmethod
    def of(views: Sequence[View], gaussians: Gaussians) -> SceneGeometry:
        """Compute the geometry of the views from which Gaussians were predicted.

        Depth is that of the Gaussians in the given cameras, because a predictor may have refined
        surfaces and cameras after matching; that of Gaussians of no pixel is rendered. The views of
        the result are in the coordinates of the Gaussians' means, in which float32 holds positions.
        """
        depths = view_depths(gaussians, [view.camera for view in views])
        for view, depth in zip(views, depths, strict=True):
            if view.opaque is not None:
                depth[~view.opaque] = 0  # Gaussians of other views project there
        if gaussians.origin.any():
            views = [replace(view, camera=gaussians.localize(view.camera)) for view in views]
        return SceneGeometry(
            tuple(SeenView(view, depth) for view, depth in zip(views, depths, strict=True))
        )

    @cached_property
    def views(self) -> tuple[View, ...]:
        """Context views."""
        return tuple(frame.view for frame in self.frames)

    @cached_property
    def depths(self) -> np.ndarray:
        """Predicted z-depth of every view, float32 [V, H, W] in scene units, 0 where unknown."""
        return np.stack([frame.require_depth() for frame in self.frames])

    def seen_again(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """Return masks of the pixels of view ``first`` inside view ``second``, and visible there.

        Two bool [H, W].
        """
        inside, _, z, observed = self._project(first, second)
        return inside, inside & (observed > 0) & (
            np.abs(z - observed) <= DEPTH_TOLERANCE * observed
        )

    def _project(self, first: int, second: int) -> tuple[np.ndarray, ...]:
        """Project the pixels of view ``first`` into view ``second``.

        Returns:
            bool [H, W], float64 [H, W, 2], float64 [H, W], float32 [H, W]: Mask of those inside,
                pixels, 0 outside, their depth, and the depth that the second view has there.
        """
        depth, target = self.depths[first], self.views[second].camera
        pixels, z = target.project(self.views[first].camera.unproject(depth))
        inside = (depth > 0) & target.shows(pixels, z)
        pixels[~inside] = 0
        # Of float64: float32 may round up to the width.
        column, row = pixels.astype(np.int64).transpose(2, 0, 1)
        return inside, pixels, z, self.depths[second][row, column]

    def clash(self, first: int, second: int) -> float:
        """Return the share of visible pixels of view ``first`` with another colour in ``second``.

        Smoothed colours of pixels that are inside the second view and not occluded there are
        compared after compensation of exposure. Where they differ by more than
        :data:`CLASH_DISTANCE`, an object moved or the depth is wrong. 0 if there are no such
        pixels.
        """
        inside, pixels, z, observed = self._project(first, second)
        u, v = pixels.astype(np.float32).transpose(2, 0, 1)
        visible = inside & (z <= (1 + DEPTH_TOLERANCE) * observed)
        if not visible.any():
            return 0.0
        lab, target_lab = (
            cv2.GaussianBlur(self.views[i].lab, (0, 0), SMOOTHING_STD) for i in (first, second)
        )
        difference = (lab - cv2.remap(target_lab, u - 0.5, v - 0.5, cv2.INTER_LINEAR))[visible]
        return float(
            (np.linalg.norm(difference - np.median(difference, 0), axis=-1) > CLASH_DISTANCE).mean()
        )

    @cached_property
    def room(self) -> Room:
        """Up direction and floor of the scene."""
        return find_room([view.camera for view in self.views], self.depths)

    @cached_property
    def surroundings(self) -> tuple[Surroundings, ...]:
        """Positions of the pixels of every view in the room."""
        return tuple(
            self.room.place(view.camera, depth)
            for view, depth in zip(self.views, self.depths, strict=True)
        )


def view_depths(gaussians: Gaussians, cameras: Sequence[Camera]) -> np.ndarray:
    """Compute depth maps of context views, float32 [V, H, W] in scene units, 0 where unknown.

    That of the pixels' Gaussians (:func:`slgaussian.gaussians.source_depths`); where they are of no
    pixel, the rendered median depth.
    """
    if gaussians.pixelwise:
        return source_depths(gaussians, cameras)
    nothing = np.zeros((len(gaussians), 1), np.float32)
    drawn = (picture(gaussians, nothing, camera, "3dgs", median=True) for camera in cameras)
    return np.stack([view.median for view in drawn])
