"""CPU rasterization of NumPy arrays, as :func:`slgaussian.rasterize.rasterize` of tensors.

Fields are queried and rendered with it, without the import of torch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slgaussian.gaussians import SH_C0, Gaussians
from slgaussian.rasterize.api import Render, check_inputs
from slgaussian.rasterize.blend import SplatScene, draw
from slgaussian.rasterize.project import Eye, make_eye, project
from slgaussian.rasterize.render_settings import Settings, find_settings
from slgaussian.rasterize.tiles import bin_splats
from slgaussian.scene import Camera

GEOMETRY = ("means", "scales", "quats", "opacities")


class Picture(NamedTuple):
    """A rendered view: :class:`slgaussian.rasterize.Render` as float32 arrays."""

    values: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    median: np.ndarray

    @staticmethod
    def of(render: Render) -> Picture:
        """Convert the result of any backend, on any device."""
        tensors = render.values, render.alpha, render.depth, render.median
        return Picture(
            *(
                np.empty(0, np.float32) if t is None else t.detach().cpu().float().numpy()
                for t in tensors
            )
        )


def picture(
    gaussians: Gaussians,
    values: np.ndarray,
    camera: Camera,
    settings: Settings | str = "fast",
    median: bool = False,
) -> Picture:
    """Render Gaussians with ``values`` float32 [N, C]; the rest is as in ``rasterize``.

    Raises:
        InputError: If a number is invalid, naming the first Gaussian with one.
    """
    settings, arrays = find_settings(settings, gaussians.reach(camera)), gaussians.to_arrays()
    geometry = [np.ascontiguousarray(arrays[name], np.float32) for name in GEOMETRY]
    drawn, _ = draw_splats(
        gaussians, geometry, np.ascontiguousarray(values, np.float32),
        make_eye(gaussians.localize(camera), settings), settings, median,
    )  # fmt: skip
    return Picture(*drawn)


def compute_view_colours(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """Compute :func:`~slgaussian.rasterize.harmonics.compute_colours` in NumPy: float32 [N, 3]."""
    sh = gaussians.to_arrays()["sh"]
    if sh.shape[1] == 1 and sh.dtype == np.float32:
        plain: np.ndarray = np.maximum(sh[:, 0] * np.float32(SH_C0) + np.float32(0.5), 0)
        return plain
    from slgaussian.rasterize.harmonics import compute_colours  # other degrees need torch

    rgb: np.ndarray = compute_colours(gaussians, camera).detach().cpu().numpy()
    return rgb


def draw_splats(
    gaussians: Gaussians,
    geometry: list[np.ndarray],
    values: np.ndarray,
    eye: Eye,
    settings: Settings,
    median: bool,
) -> tuple[tuple[np.ndarray, ...], SplatScene]:
    """Project, bin and draw; return the images of :func:`slgaussian.rasterize.blend.draw` too.

    ``geometry`` are the arrays :data:`GEOMETRY` of ``gaussians``, contiguous float32. Raises
    InputError naming the first Gaussian with an invalid number.
    """
    splats, boxes, sensible = project(geometry, values, eye)
    if not sensible:
        check_inputs(gaussians, values)
    bins = bin_splats(boxes, eye.width, eye.height)
    limits = np.float32(settings.alpha_max), np.float32(settings.pass_min)
    scene = SplatScene(splats, boxes, values, bins, *limits)
    return draw(scene, eye.width, eye.height, median), scene
