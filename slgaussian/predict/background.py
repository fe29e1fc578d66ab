"""Gaussians for unseen regions: beyond the image borders, and behind foreground surfaces.

Novel views between the photographs show parts of these regions. The nearest surface is extrapolated
at its depth in its colour.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.predict.unproject import THICKNESS
from slgaussian.scene import Camera

BLOCK_SIDE = 4
"""Side of the block of pixels that each of these Gaussians covers."""

BLOCK_STD = 0.5
"""Standard deviation of such a Gaussian, in blocks."""

MARGIN_SHARE = 0.07
"""Width of the extrapolated margin, as a share of the longer side of the image."""

MAX_BLOCKS = 12
MIN_DEPTH_STEPS = 6.0
"""Largest number of blocks by which a surface is extrapolated behind a nearer one, and the smallest
difference of their depths, in candidate steps. One step is about one pixel of parallax, and a block
farther from the edge than the parallax is never disoccluded between the views."""

OCCLUSION_TOLERANCE = 0.03
"""Relative depth by which a point must lie behind the surface of a view to count as occluded."""

OPACITY_BEYOND = 0.6
OPACITY_BEHIND = 0.3
"""Opacities of the two kinds. The first closes a surface by itself. The second is faint because it
shines through the foreground; it fills regions that would be black."""


def continue_surfaces(
    cameras: Sequence[Camera],
    colours: Sequence[np.ndarray],
    inverse_depths: Sequence[np.ndarray],
    steps: Sequence[float],
) -> Gaussians:
    """Extrapolate the surfaces of every view into regions that no other view shows.

    Args:
        cameras: V Camera of one size
        colours: V of float32 [H, W, 3]. RGB in [0, 1].
        inverse_depths: V of float32 [H, W]
        steps: V of float. Distance between candidates.

    Returns:
        Gaussians: Some per cent of V * H * W. ``source`` is the pixel that each extrapolates: the
            Gaussian has the depth of that pixel, its colour or that of its block, and should have
            its label.
    """
    parts = []
    for i, camera in enumerate(cameras):
        beyond = _blocks_beyond_borders(colours[i], inverse_depths[i])
        behind = _blocks_behind_edges(colours[i], inverse_depths[i], steps[i])
        opacity = np.repeat([OPACITY_BEYOND, OPACITY_BEHIND], [len(beyond[0]), len(behind[0])])
        centre, pixel, rgb = (np.concatenate(p) for p in zip(beyond, behind, strict=True))
        column, row = pixel.T
        depth = 1 / inverse_depths[i][row, column].astype(np.float64)
        rays = np.concatenate([centre, np.ones((len(centre), 1))], 1) @ np.linalg.inv(camera.K).T
        means = camera.center + (rays * depth[:, None]) @ camera.c2w[:3, :3].T
        unseen = np.ones(len(means), bool)
        for j, camera_j in enumerate(cameras):
            if j != i:
                unseen &= _is_unseen(means, camera_j, inverse_depths[j])
        width = BLOCK_STD * BLOCK_SIDE * depth / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
        turn = Rotation.from_matrix(camera.c2w[:3, :3]).as_quat()[[3, 0, 1, 2]]
        scales = width[:, None] * (1, 1, THICKNESS)
        source = (i * camera.height + row) * camera.width + column
        quats = np.tile(turn, (len(means), 1))
        fields = {"means": means, "scales": scales, "quats": quats, "opacities": opacity, "sh": rgb}
        arrays = {name: values[unseen].astype(np.float32) for name, values in fields.items()}
        arrays["sh"] = rgb_to_sh(arrays["sh"])
        arrays["source"] = source[unseen].astype(np.int32)
        parts.append(Gaussians.from_arrays(arrays))
    return Gaussians.concatenate(parts)


def _blocks_beyond_borders(colour: np.ndarray, inverse_depth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return blocks around the image: their centres (x, y), nearest pixels, and colours."""
    H, W = inverse_depth.shape
    blocks = int(np.ceil(MARGIN_SHARE * max(H, W) / BLOCK_SIDE))
    x, y = (
        (np.arange(-blocks, size // BLOCK_SIDE + 1 + blocks) + 0.5) * BLOCK_SIDE for size in (W, H)
    )
    x, y = (grid.ravel() for grid in np.meshgrid(x, y))
    outside = (x < 0) | (x > W) | (y < 0) | (y > H)
    centre = np.stack([x, y], 1)[outside]
    pixel = np.floor(centre).astype(np.int64).clip(0, (W - 1, H - 1))
    return centre, pixel, colour[pixel[:, 1], pixel[:, 0]]


def _blocks_behind_edges(
    colour: np.ndarray, inverse_depth: np.ndarray, step: float
) -> tuple[np.ndarray, ...]:
    """Return blocks behind depth edges likewise, each with a pixel of the farther surface."""
    H, W = (-(-size // BLOCK_SIDE) for size in inverse_depth.shape)
    ragged = [(0, -size % BLOCK_SIDE) for size in inverse_depth.shape]
    padded = np.pad(inverse_depth, ragged, "edge").reshape(H, BLOCK_SIDE, W, BLOCK_SIDE)
    tiles = padded.transpose(0, 2, 1, 3).reshape(H, W, BLOCK_SIDE * BLOCK_SIDE)
    farthest = tiles.argmin(-1)
    rows, columns = np.arange(H)[:, None], np.arange(W)
    nearest, best = tiles.max(-1), tiles.min(-1)
    best_row, best_column = (
        rows * BLOCK_SIDE + farthest // BLOCK_SIDE,
        columns * BLOCK_SIDE + farthest % BLOCK_SIDE,
    )
    chosen, pixels = np.zeros((H, W), bool), np.zeros((H, W, 2), np.int64)
    for ring in range(MAX_BLOCKS):
        around = np.pad(np.stack([best, best_row, best_column]), ((0, 0), (1, 1), (1, 1)), "edge")
        for dy in range(3):
            for dx in range(3):
                w, row, column = around[:, dy : dy + H, dx : dx + W]
                farther = w < best
                best = np.where(farther, w, best)
                best_row = np.where(farther, row, best_row)
                best_column = np.where(farther, column, best_column)
        new = ~chosen & (nearest - best > max(MIN_DEPTH_STEPS, BLOCK_SIDE * ring) * step)
        chosen |= new
        pixels[new] = np.stack([best_column[new], best_row[new]], 1)
    y, x = np.nonzero(chosen)
    centre = (np.stack([x, y], 1) + 0.5) * BLOCK_SIDE
    pixel = np.minimum(pixels[y, x], np.array(inverse_depth.shape)[::-1] - 1)
    return centre, pixel, colour[pixel[:, 1], pixel[:, 0]]


def _is_unseen(points: np.ndarray, camera: Camera, inverse_depth: np.ndarray) -> np.ndarray:
    """Return the mask of points [M, 3] outside a view or behind its surface, bool [M]."""
    pixels, z = camera.project(points)
    inside = camera.shows(pixels, z)
    column, row = np.where(inside[:, None], pixels, 0).astype(np.int64).T
    return ~inside | (z * inverse_depth[row, column] > 1 + OCCLUSION_TOLERANCE)
