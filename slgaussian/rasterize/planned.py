"""Rendering with frozen geometry by precomputed weights.

With fixed means, covariances and opacities a rendering is linear in the values:
``image = W values``, with W the weight of every Gaussian in every pixel. The semantic branch of the
paper learns features on frozen Gaussians (section 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vany, vload, vload_half, vstore, vstore_half, vsum, vzero
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.blend import blend_weights
from slgaussian.rasterize.cpu import to_kernel_arrays
from slgaussian.rasterize.picture import GEOMETRY, checked
from slgaussian.rasterize.project import SHARE, eye_of
from slgaussian.rasterize.render_settings import Settings, find_settings
from slgaussian.rasterize.tiles import (
    BLOCK,
    STRIP,
    TILE_BLOCKS,
    bin_splats,
    corner_of,
    fullest,
    load_tile,
    make_workspace,
    strips_of,
)
from slgaussian.scene import Camera

WEIGHT_MIN = 1 / 16384
"""Threshold at or below which all weights of a block are dropped."""

GROUP = 4
"""Number of channels accumulated in registers; values are padded to a multiple of it."""


@dataclass(frozen=True, eq=False)
class SplatPlan:
    """Precomputed weights of one view, to be multiplied with any values.

    The weights of a Gaussian in a block of 4x4 pixels are a vector. They are stored with 11 bits of
    precision, because memory bandwidth limits the product.

    Attributes
    ----------
    height, width, count : int
        Of the image, and of Gaussians.
    alpha : float32 [H, W]
        Accumulated opacity.
    starts : int64 [blocks + 1]
        Block b, of ``ceil(H / 4) * ceil(W / 4)``, has the entries ``starts[b] : starts[b + 1]``,
        front to back.
    members : int32 [entries]
        The Gaussian of each entry.
    weights : uint16 [entries * 16]
        Bits of float16.
    by_gaussian : tuple of int64 [count + 1], int32 [entries]
        Where each Gaussian's entries start in the second array, which holds their blocks.
    weights_by_gaussian : uint16 [entries * 16]
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
    """Compute the weights of ``gaussians`` in the pixels of ``camera``.

    Raises
    ------
    InputError
        As :func:`slgaussian.rasterize.rasterize` does.
    """
    settings = find_settings(settings)
    gaussians, nothing = to_kernel_arrays(gaussians, torch.zeros(len(gaussians), 0))
    eye = eye_of(camera, settings)
    geometry = [getattr(gaussians, name).detach().numpy() for name in GEOMETRY]
    splats, boxes = checked(gaussians, geometry, nothing.numpy(), eye)
    bins = bin_splats(boxes, eye.width, eye.height)
    limits = np.float32(settings.alpha_max), np.float32(settings.pass_min)
    blocks = -(-eye.height // BLOCK) * -(-eye.width // BLOCK)
    counts, alpha = np.zeros(blocks + 1, np.int64), np.empty((eye.height, eye.width), np.float32)
    scene = splats, boxes, nothing.numpy(), bins, *limits
    strips = strips_of(bins)
    share(
        _list_weights,
        strips,
        *scene,
        alpha,
        counts,
        False,
        np.empty(0, np.int32),
        np.empty(0, np.uint16),
    )
    starts = np.concatenate([[0], np.cumsum(counts[:-1])])
    members = np.empty(starts[-1], np.int32)
    weights = np.empty(starts[-1] * LANES, np.uint16)
    share(_list_weights, strips, *scene, alpha, starts, True, members, weights)
    transposed = _transpose(starts, members, weights, len(gaussians))
    return SplatPlan(
        eye.height, eye.width, len(gaussians), torch.from_numpy(alpha), starts, members, weights,
        transposed[:2], transposed[2],
    )  # fmt: skip


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, plan: SplatPlan) -> torch.Tensor:
        ctx.plan = plan
        channels = values.shape[1]
        image = np.empty((plan.height, plan.width, channels), np.float32)
        flat = np.zeros((plan.count, -(-channels // GROUP) * GROUP), np.float32)
        flat[:, :channels] = values.numpy()
        share(_multiply, -(-plan.height // BLOCK), plan.starts, plan.members, plan.weights, flat,
              image)  # fmt: skip
        return torch.from_numpy(image)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> tuple[torch.Tensor, None]:
        plan = ctx.plan
        channels = upstream.shape[2]
        grads = np.empty((plan.count, channels), np.float32)
        rows, across = -(-plan.height // BLOCK), -(-plan.width // BLOCK)
        padded = -(-channels // GROUP) * GROUP
        planes = np.zeros(rows * across * padded * LANES, np.float32)
        share(_lay_out, rows, np.ascontiguousarray(upstream.numpy()), planes)
        share(_multiply_transposed, -(-plan.count // SHARE), *plan.by_gaussian,
              plan.weights_by_gaussian, planes, grads)  # fmt: skip
        return torch.from_numpy(grads), None


@kernel
def _list_weights(
    counter,
    splats,
    boxes,
    values,
    bins,
    alpha_max,
    pass_min,
    alpha,
    starts,
    write,
    members,
    weights,
):
    """Count the entries of every block into ``starts``, or ``write`` them from there."""
    height, width = alpha.shape
    across = -(-width // BLOCK)
    strip, tiles = take(counter), bins.across * bins.down
    if strip * STRIP >= tiles:
        return
    capacity = fullest(bins)
    work = make_workspace(capacity, 0)
    alphas = np.empty(LANES, np.float32)
    while strip * STRIP < tiles:
        for tile in range(strip * STRIP, min(tiles, (strip + 1) * STRIP)):
            left, top = load_tile(tile, bins, splats, boxes, values, work)
            for block in range(TILE_BLOCKS):
                x0, y0 = corner_of(block, left, top)
                if x0 >= width or y0 >= height:
                    continue
                used, _, block_alphas = blend_weights(block, work, alpha_max, pass_min)
                vstore(alphas, 0, block_alphas)
                for y in range(y0, min(y0 + BLOCK, height)):
                    for x in range(x0, min(x0 + BLOCK, width)):
                        lane = (y - y0) * BLOCK + x - x0
                        alpha[y, x] = min(alphas[lane], np.float32(1))
                block_index = y0 // BLOCK * across + x0 // BLOCK
                written = 0
                for j in range(used):
                    weight = vload(work.weights, j * LANES)
                    if vany(weight > np.float32(WEIGHT_MIN)):
                        if write:
                            k = work.lists[block * capacity + j]
                            entry = starts[block_index] + written
                            members[entry] = bins.entries[bins.starts[tile] + k]
                            vstore_half(weights, entry * LANES, weight)
                        written += 1
                if not write:
                    starts[block_index] = written
        strip = take(counter)


@kernel
def _transpose(starts, members, weights, count):
    """Transpose the entries to Gaussian-major order; return starts, blocks and weights."""
    begins = np.zeros(count + 1, np.int64)
    for member in members:
        begins[member + 1] += 1
    begins = np.cumsum(begins)
    cursor = begins[:-1].copy()
    blocks = np.empty(len(members), np.int32)
    transposed = np.empty(len(weights), np.uint16)
    for block in range(len(starts) - 1):
        for entry in range(starts[block], starts[block + 1]):
            place = cursor[members[entry]]
            cursor[members[entry]] += 1
            blocks[place] = block
            vstore(transposed, place * LANES, vload(weights, entry * LANES))
    return begins, blocks, transposed


@kernel
def _lay_out(counter, upstream, planes):
    """Write an image into ``planes``: block by block, and channel by channel within one."""
    height, width, channels = upstream.shape
    across, padded = -(-width // BLOCK), -(-channels // GROUP) * GROUP
    down = take(counter)
    while down * BLOCK < height:
        for y in range(down * BLOCK, min((down + 1) * BLOCK, height)):
            for x in range(width):
                at = (down * across + x // BLOCK) * padded * LANES
                at += y % BLOCK * BLOCK + x % BLOCK
                for c in range(channels):
                    planes[at + c * LANES] = upstream[y, x, c]
        down = take(counter)


@kernel
def _multiply(counter, starts, members, weights, values, image):
    """Write the sums of the rows of ``values``, padded to whole groups, by weight."""
    height, width, channels = image.shape
    padded, flat = values.shape[1], values.ravel()
    across, sums = -(-width // BLOCK), np.empty(GROUP * LANES, np.float32)
    down = take(counter)
    while down * BLOCK < height:
        y0 = down * BLOCK
        for column in range(across):
            x0, block = column * BLOCK, down * across + column
            for c in range(0, channels, GROUP):
                p, q, r, s = vzero(), vzero(), vzero(), vzero()
                for entry in range(starts[block], starts[block + 1]):
                    weight = vload_half(weights, entry * LANES)
                    at = np.int64(np.uint32(members[entry])) * padded + c
                    p = p + weight * flat[at]
                    q = q + weight * flat[at + 1]
                    r = r + weight * flat[at + 2]
                    s = s + weight * flat[at + 3]
                vstore(sums, 0, p)
                vstore(sums, LANES, q)
                vstore(sums, 2 * LANES, r)
                vstore(sums, 3 * LANES, s)
                for y in range(y0, min(y0 + BLOCK, height)):
                    for x in range(x0, min(x0 + BLOCK, width)):
                        lane = (y - y0) * BLOCK + x - x0
                        for k in range(min(GROUP, channels - c)):
                            image[y, x, c + k] = sums[k * LANES + lane]
        down = take(counter)


@kernel
def _multiply_transposed(counter, begins, blocks, weights, planes, grads):
    """Write the sums of ``planes``, in the order of :func:`_lay_out`, for each Gaussian."""
    n, channels = grads.shape
    padded = -(-channels // GROUP) * GROUP
    start = take(counter) * SHARE
    while start < n:
        for i in range(start, min(n, start + SHARE)):
            for c in range(0, channels, GROUP):
                p, q, r, s = vzero(), vzero(), vzero(), vzero()
                for entry in range(begins[i], begins[i + 1]):
                    weight = vload_half(weights, entry * LANES)
                    at = (np.int64(np.uint32(blocks[entry])) * padded + c) * LANES
                    p = p + weight * vload(planes, at)
                    q = q + weight * vload(planes, at + LANES)
                    r = r + weight * vload(planes, at + 2 * LANES)
                    s = s + weight * vload(planes, at + 3 * LANES)
                for k, total in enumerate((p, q, r, s)):
                    if c + k < channels:
                        grads[i, c + k] = vsum(total)
        start = take(counter) * SHARE
