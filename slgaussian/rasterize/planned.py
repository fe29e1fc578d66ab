"""Rendering with frozen geometry: keep the weights, and only multiply.

Where means, covariances and opacities stay, a rendering is linear in the values:
``image = W values``, with W the weight of every Gaussian in every pixel. That is the semantic
branch of the paper, which learns features on frozen Gaussians (section 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize.blend import BLOCKS, weigh_row
from slgaussian.rasterize.cpu import as_kernels_take_them, project_checked
from slgaussian.rasterize.project import eye_of
from slgaussian.rasterize.settings import Settings, find_settings
from slgaussian.rasterize.tiles import (
    TILE_HEIGHT,
    TILE_WIDTH,
    bin_splats,
    fullest,
    load_tile,
    make_workspace,
)
from slgaussian.scene import Camera
from slgaussian.simd import LANES, vany, viota, vload, vstore, vsum

WEIGHT_MIN = 1 / 4096
"""Weights of eight pixels are left out where all are at or below this."""


@dataclass(frozen=True, eq=False)
class SplatPlan:
    """The weights of one view, ready to be multiplied with any values.

    A row of eight pixels is a vector, and so are the eight weights that a Gaussian has in it.

    Attributes
    ----------
    height, width, count : int
        Of the image, and of Gaussians.
    alpha : float32 [H, W]
        Accumulated opacity.
    starts : int64 [rows + 1]
        Row r, of ``H * ceil(W / 8)``, has the entries ``starts[r] : starts[r + 1]``, front to back.
    members : int32 [entries]
        The Gaussian of each entry.
    weights : float32 [entries * 8]
    by_gaussian : tuple of int64 [count + 1], int32 [entries]
        Where each Gaussian's entries start in the second array, which holds their rows.
    weights_by_gaussian : float32 [entries * 8]
        The weights in that order.
    """

    height: int
    width: int
    count: int
    alpha: torch.Tensor
    starts: np.ndarray
    members: np.ndarray
    weights: np.ndarray
    by_gaussian: tuple[np.ndarray, np.ndarray]
    weights_by_gaussian: np.ndarray

    def render(self, values: torch.Tensor) -> torch.Tensor:
        """Composite ``values`` float [N, C]: float32 [H, W, C], differentiable in the values.

        Raises
        ------
        InputError
            If ``values`` does not have a row a Gaussian.
        """
        if values.ndim != 2 or values.shape[0] != self.count:
            raise InputError(
                f"plan values: found shape {tuple(values.shape)}, expected ({self.count}, C)"
            )
        return _Product.apply(values.to("cpu", torch.float32).contiguous(), self)


def plan(gaussians: Gaussians, camera: Camera, settings: Settings | str = "fast") -> SplatPlan:
    """Work out the weights of ``gaussians`` in the pixels of ``camera``, once.

    Raises
    ------
    InputError
        As :func:`slgaussian.rasterize.rasterize` does.
    """
    settings = find_settings(settings)
    gaussians, nothing = as_kernels_take_them(gaussians, torch.zeros(len(gaussians), 0))
    eye = eye_of(camera, settings)
    splats, boxes = project_checked(gaussians, nothing, eye)
    bins = bin_splats(boxes, eye.width, eye.height)
    limits = np.float32(settings.alpha_max), np.float32(settings.pass_min)
    rows = eye.height * bins.across
    counts, alpha = np.zeros(rows + 1, np.int64), np.empty((eye.height, eye.width), np.float32)
    scene = splats, boxes, nothing.numpy(), bins, *limits
    _weigh(*scene, alpha, counts, False, np.empty(0, np.int32), np.empty(0, np.float32))
    starts = np.concatenate([[0], np.cumsum(counts[:-1])])
    members = np.empty(starts[-1], np.int32)
    weights = np.empty(starts[-1] * LANES, np.float32)
    _weigh(*scene, alpha, starts, True, members, weights)
    turned = _turn(starts, members, weights, len(gaussians))
    return SplatPlan(
        eye.height, eye.width, len(gaussians), torch.from_numpy(alpha), starts, members, weights,
        turned[:2], turned[2],
    )  # fmt: skip


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, plan: SplatPlan) -> torch.Tensor:
        ctx.plan = plan
        image = _multiply(plan.starts, plan.members, plan.weights, values.numpy(), plan.height,
                          plan.width)  # fmt: skip
        return torch.from_numpy(image)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> tuple[torch.Tensor, None]:
        plan = ctx.plan
        grads = _multiply_turned(
            *plan.by_gaussian, plan.weights_by_gaussian, np.ascontiguousarray(upstream.numpy())
        )
        return torch.from_numpy(grads), None


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _weigh(
    splats, boxes, values, bins, alpha_max, pass_min, alpha, starts, write, members, weights
):
    """Count the entries of every row into ``starts``, or ``write`` them where it says."""
    height, width = alpha.shape
    most = fullest(bins)
    for block in numba.prange(BLOCKS):
        work = make_workspace(most, 0)
        solids = np.empty(LANES, np.float32)
        for tile in range(block, bins.across * bins.down, BLOCKS):
            left, top = load_tile(tile, bins, splats, boxes, values, work)
            for row in range(min(TILE_HEIGHT, height - top)):
                used, _, solid = weigh_row(row, work, alpha_max, pass_min)
                vstore(solids, 0, solid)
                for x in range(min(TILE_WIDTH, width - left)):
                    alpha[top + row, left + x] = min(solids[x], np.float32(1))
                place = (top + row) * bins.across + tile % bins.across
                found = 0
                for j in range(used):
                    weight = vload(work.weights, j * LANES)
                    if vany(weight > np.float32(WEIGHT_MIN)):
                        if write:
                            k = work.rows[row * most + j]
                            entry = starts[place] + found
                            members[entry] = bins.entries[bins.starts[tile] + k]
                            vstore(weights, entry * LANES, weight)
                        found += 1
                if not write:
                    starts[place] = found


@numba.njit(cache=True)
def _turn(starts, members, weights, count):
    """The same entries Gaussian by Gaussian: where each starts, their rows and weights."""
    begins = np.zeros(count + 1, np.int64)
    for member in members:
        begins[member + 1] += 1
    begins = np.cumsum(begins)
    cursor = begins[:-1].copy()
    rows = np.empty(len(members), np.int32)
    turned = np.empty(len(weights), np.float32)
    for row in range(len(starts) - 1):
        for entry in range(starts[row], starts[row + 1]):
            place = cursor[members[entry]]
            cursor[members[entry]] += 1
            rows[place] = row
            vstore(turned, place * LANES, vload(weights, entry * LANES))
    return begins, rows, turned


@numba.njit(cache=True, parallel=True)
def _multiply(starts, members, weights, values, height, width):
    channels = values.shape[1]
    across = -(-width // LANES)
    image = np.empty((height, width, channels), np.float32)
    flat = values.ravel()
    for y in numba.prange(height):
        sums = np.empty(channels * LANES, np.float32)
        for column in range(across):
            sums[:] = 0
            row = y * across + column
            for entry in range(starts[row], starts[row + 1]):
                weight = vload(weights, entry * LANES)
                at = np.int64(np.uint32(members[entry])) * channels
                for c in range(channels):
                    total = vload(sums, c * LANES) + weight * flat[at + c]
                    vstore(sums, c * LANES, total)
            for x in range(min(LANES, width - column * LANES)):
                for c in range(channels):
                    image[y, column * LANES + x, c] = sums[c * LANES + x]
    return image


@numba.njit(cache=True, parallel=True)
def _multiply_turned(begins, rows, weights, upstream):
    height, width, channels = upstream.shape
    across = -(-width // LANES)
    # Channel by channel within a row of eight pixels, and zero past the edge of the image.
    planes = np.zeros(height * across * channels * LANES, np.float32)
    for y in numba.prange(height):
        for x in range(width):
            at = (y * across + x // LANES) * channels * LANES + x % LANES
            for c in range(channels):
                planes[at + c * LANES] = upstream[y, x, c]
    grads = np.empty((len(begins) - 1, channels), np.float32)
    for i in numba.prange(len(begins) - 1):
        for c in range(channels):
            total = viota() * np.float32(0)
            for entry in range(begins[i], begins[i + 1]):
                at = (np.int64(np.uint32(rows[entry])) * channels + c) * LANES
                total = total + vload(weights, entry * LANES) * vload(planes, at)
            grads[i, c] = vsum(total)
    return grads
