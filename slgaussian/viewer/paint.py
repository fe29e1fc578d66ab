"""What colour each Gaussian is shown in: colour, depth, objects, relevancy, code, and marks on it.

Every function takes and returns uint8 [N, 3], a row a Gaussian.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from slgaussian.benchmark import pictures
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import harmonics
from slgaussian.scene import Camera

SELECTED = pictures.PREDICTED
"""What somebody clicked."""
GUESSED = (255, 96, 208)
"""What no second view confirms."""
UNSURE = (255, 214, 10)
"""Whose object is not sure."""

_DIM = 0.4


def plain(gaussians: Gaussians, cameras: Iterable[Camera]) -> np.ndarray:
    """Colours that do not change with the viewpoint: their mean as the cameras see them.

    A browser is sent no harmonics. Without cameras, the part that all directions share.
    """
    seen = list(cameras) if gaussians.sh.shape[1] > 1 else []
    if seen:
        colours = torch.stack([harmonics.colors(gaussians, camera) for camera in seen]).mean(0)
    else:
        colours = gaussians.colors()
    return np.rint(colours.clamp(0, 1).numpy() * 255).astype(np.uint8)


def objects(labels: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """The colour of each Gaussian's object, int32 [N], shaded as the scene is."""
    ids, places = np.unique(labels, return_inverse=True)
    shade = 0.55 + 0.55 * _grey(colours) / 255
    return _bytes(pictures.label_colors(ids)[places] * shade[:, None])


def depth(means: np.ndarray, camera: Camera) -> np.ndarray:
    """z-depth of means [N, 3] from ``camera``, red near and blue far."""
    z = camera.project(means.astype(np.float64))[1].clip(0)[None]
    return pictures.paint_depth(z, *pictures.depth_range(z))[0]


def relevancy(values: np.ndarray, taken: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Relevancy [N] as heat over the grey scene, dimmer where nothing is ``taken``, bool [N]."""
    painted = pictures.paint_relevancy(values[None], colours[None])[0]
    return np.where(taken[:, None], painted, _bytes(painted * (_DIM + 0.2)))


def words(winner: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Which of several texts fits each Gaussian, int [N] from 1; grey and dim where none does."""
    fits = winner > 0
    dim = np.repeat(_bytes(_DIM * _grey(colours))[:, None], 3, 1)
    return np.where(fits[:, None], objects(winner, colours), dim)


def codes(features: np.ndarray) -> np.ndarray:
    """ID codes as colours, of features [N, D + 1]; black where there is none."""
    weight = features[:, -1:]
    code = features[:, :-1] / np.where(weight > 0, weight, 1)
    shown = np.zeros((len(features), 3))
    shown[:, : code.shape[1]] = code
    return _bytes(255 * shown)


def marked(colours: np.ndarray, mask: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """A copy with a colour laid over what is in ``mask``, bool [N]."""
    out = colours.copy()
    out[mask] = _bytes(0.45 * out[mask] + 0.55 * np.array(colour))
    return out


def outlined(
    colours: np.ndarray, own: np.ndarray, outline: np.ndarray, colour: tuple[int, int, int]
) -> np.ndarray:
    """A copy with an outline, bool [N], in a colour, and a tint of it on what is ``own``."""
    out = colours.copy()
    out[own] = _bytes(0.75 * out[own] + 0.25 * np.array(colour))
    out[outline] = colour
    return out


def _grey(colours: np.ndarray) -> np.ndarray:
    return colours @ np.array([0.299, 0.587, 0.114])


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
