"""Photographs, COLMAP models written by pycolmap, and rows of LLFF poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

WIDTH, HEIGHT = 96, 64
FOCAL = 80.0
PINHOLE = ("PINHOLE", (80.0, 82.0, 47.3, 33.1))


@dataclass(frozen=True)
class Shot:
    """An image of a model: its id, camera id, position and rotation about y in degrees."""

    number: int
    camera: int = 1
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0

    def w2c(self) -> np.ndarray:
        """World-to-camera, float64 [3, 4]."""
        a = np.radians(self.turn)
        R = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        return np.column_stack([R, -R @ self.place])


def picture(seed: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def write_pictures(folder: Path, names: Sequence[str], width=WIDTH, height=HEIGHT) -> None:
    for i, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture(i, width, height)).save(folder / name)


def write_model(
    folder: Path,
    shots: Mapping[str, Shot],
    cameras: Mapping[int, tuple[str, Sequence[float]]] | None = None,
    points: np.ndarray | None = None,
    text: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
):
    """Write and return a reconstruction in which every image sees every point."""
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    for number, (name, params) in (cameras or {1: PINHOLE}).items():
        camera = pycolmap.Camera(
            camera_id=number, model=name, width=size[0], height=size[1], params=list(params)
        )
        model.add_camera_with_trivial_rig(camera)
    points = np.zeros((0, 3)) if points is None else points
    for name, shot in shots.items():
        image = pycolmap.Image(image_id=shot.number, name=name, camera_id=shot.camera)
        image.points2D = pycolmap.Point2DList(
            [pycolmap.Point2D(np.array([float(k), 1.0])) for k in range(len(points))]
        )
        w2c = shot.w2c()
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(w2c[:, :3]), w2c[:, 3])
        model.add_image_with_trivial_frame(image, pose)
    for k, point in enumerate(points):
        track = [pycolmap.TrackElement(shot.number, k) for shot in shots.values()]
        model.add_point3D(point, pycolmap.Track(track))
    folder.mkdir(parents=True, exist_ok=True)
    (model.write_text if text else model.write)(folder)
    return model


def llff_row(
    place=(0.0, 0.0, 0.0), size=(HEIGHT, WIDTH), near=2.0, far=9.0, focal=FOCAL
) -> list[float]:
    """Return a row of poses_bounds for a camera that looks along z."""
    right, down, forward = np.eye(3)
    matrix = np.column_stack([down, right, -forward, place, (*size, focal)])
    return [*matrix.ravel(), near, far]
