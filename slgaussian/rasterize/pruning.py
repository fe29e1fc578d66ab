"""Leave out the Gaussians that some views do not need, and say by how much the views change.

Every pixel of every view keeps the list of what it is composited from. Gaussians are tried one by
one, the faintest first: the pixels that one touches are composited again without it, and without
all that went before it, and compared with what they were at first. So no error is estimated, none
adds up unseen, and errors of opposite sign cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.harmonics import colors
from slgaussian.rasterize.api import rasterize
from slgaussian.rasterize.blend import SHARES, weigh_block
from slgaussian.rasterize.cpu import as_kernels_take_them, project_checked
from slgaussian.rasterize.project import eye_of
from slgaussian.rasterize.settings import Settings, find_settings
from slgaussian.rasterize.tiles import (
    ACROSS,
    BLOCK,
    BLOCKS_ACROSS,
    DOWN,
    TILE_BLOCKS,
    bin_splats,
    fullest,
    load_tile,
    make_workspace,
)
from slgaussian.scene import Camera
from slgaussian.simd import LANES, vany, vload, vstore, vsum, vwhere, vzero

GROUP = 4
"""Channels composited side by side."""

NOISE = 1e-6
"""What is left of the tolerance to rounding: opacity is summed by the rasteriser, and one less the
light here. Measured: 5e-7."""


@dataclass(frozen=True, eq=False)
class Pruned:
    """What is left, and what that changed.

    Attributes
    ----------
    gaussians : Gaussians
        The Gaussians that stay, unchanged and in their order.
    kept : int64 [M]
        Their indices among those that were given.
    error : float
        The greatest change of any channel of any pixel of the given views, measured by rendering
        them before and after; at most the tolerance.
    """

    gaussians: Gaussians
    kept: torch.Tensor
    error: float


def prune(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    tolerance: float,
    *,
    settings: Settings | str = "fast",
) -> Pruned:
    """Drop Gaussians for as long as no pixel of the given views changes by more than ``tolerance``.

    What counts are the channels that are drawn: colour, seen from each camera; ``features``, if
    there are any; and accumulated opacity, so that a background stays what it was. Depth may move
    where things of one colour lie behind one another. What no given view sees changes none of
    their pixels, and goes: give all the views that matter.

    Gaussians that a view's own pixels gave birth to are on top in that view, and nearly all stay
    at a grey level; hidden and faint ones, and those out of sight, go.

    Parameters
    ----------
    gaussians : Gaussians
    cameras : sequence of Camera
        The views to keep. Each takes about 70 bytes for every block of 4x4 pixels that a Gaussian
        touches: 130 MB at 416x576 with a Gaussian a pixel of two such views.
    tolerance : float
        0 or more, in the units of the values: 1/255 is a grey level. At 0 only what has no part in
        any pixel goes.
    settings : Settings or name of a preset
        How the views are drawn; see :func:`slgaussian.rasterize.rasterize`.

    Raises
    ------
    InputError
        If there is no camera, the tolerance is negative or not finite, or the Gaussians cannot be
        drawn.
    """
    if not 0 <= tolerance < np.inf:
        raise InputError(f"prune tolerance: found {tolerance}, expected a number of 0 or more")
    if not cameras:
        raise InputError(
            "prune cameras: found none, expected the views that are to stay as they are"
        )
    settings = find_settings(settings)
    before = [_draw(gaussians, camera, settings) for camera in cameras]
    views, values = _list_views(gaussians, cameras, settings)
    finished = np.float32(max(settings.pass_min, 1e-30))
    reference, weight = _composite_all(views, values, finished)
    limit = np.float32(max(0.0, tolerance - NOISE))
    order = np.argsort(weight, kind="stable")
    frozen = np.zeros(len(reference), np.bool_)
    while True:
        kept = torch.from_numpy(_drop(order, views, values, reference, frozen, finished, limit))
        left = gaussians[kept]
        after = [_draw(left, camera, settings) for camera in cameras]
        changes = [(a - b).abs().amax(2) for a, b in zip(after, before, strict=True)]
        error = max(float(change.max()) for change in changes)
        if error <= tolerance:
            return Pruned(left, kept.nonzero()[:, 0], error)
        # Where rounding moved a cut-off, which is a jump. All that such a block may draw has to
        # stay, so this ends.
        frozen |= np.concatenate([_blocks(change > tolerance) for change in changes])


class _Views(NamedTuple):
    """The lists of all blocks of all views, and where each Gaussian is in them.

    Attributes
    ----------
    starts : int64 [blocks + 1]
        Block b has the entries ``starts[b] : starts[b + 1]``, front to back.
    members : int32 [entries]
        The Gaussian of each entry.
    alphas : float32 [entries * LANES]
    views : int32 [blocks]
        Which view each block belongs to.
    begins : int64 [N + 1]
        Gaussian i is in the blocks ``blocks[begins[i] : begins[i + 1]]``.
    blocks : int32 [entries]
    """

    starts: np.ndarray
    members: np.ndarray
    alphas: np.ndarray
    views: np.ndarray
    begins: np.ndarray
    blocks: np.ndarray


def _values(gaussians: Gaussians, camera: Camera, settings: Settings) -> torch.Tensor:
    """The channels that count: float32 [N, C]."""
    colour = colors(gaussians, camera, settings.harmonics)
    carried = [] if gaussians.features is None else [gaussians.features]
    return torch.cat([colour, *carried], 1).detach().to("cpu", torch.float32)


def _draw(gaussians: Gaussians, camera: Camera, settings: Settings) -> torch.Tensor:
    """The channels that count, and accumulated opacity: float32 [H, W, C + 1]."""
    values = _values(gaussians, camera, settings)
    with torch.no_grad():
        drawn = rasterize(gaussians, values, camera, backend="cpu", settings=settings)
    return torch.cat([drawn.values, drawn.alpha[..., None]], 2)


def _list_views(
    gaussians: Gaussians, cameras: Sequence[Camera], settings: Settings
) -> tuple[_Views, np.ndarray]:
    """The lists, and what Gaussians carry in each view: float32 [V, N, C to a whole GROUP]."""
    n = len(gaussians)
    solid, nothing = as_kernels_take_them(gaussians, torch.zeros(n, 0))
    carried, seen, counts = [], [], []
    for camera in cameras:
        values = _values(gaussians, camera, settings).numpy()
        carried.append(np.pad(values, ((0, 0), (0, -values.shape[1] % GROUP))))
        splats, boxes = project_checked(solid, nothing, eye_of(camera, settings))
        bins = bin_splats(boxes, camera.width, camera.height)
        view = (splats, boxes, bins, camera.width, camera.height, np.float32(settings.alpha_max))
        count = np.zeros(-(-camera.height // BLOCK) * -(-camera.width // BLOCK), np.int64)
        _list(*view, count, False, np.empty(0, np.int32), np.empty(0, np.float32))
        seen.append(view)
        counts.append(count)
    sizes = [len(count) for count in counts]
    starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    members = np.empty(starts[-1], np.int32)
    alphas = np.empty(starts[-1] * LANES, np.float32)
    cursors = np.split(starts[:-1].copy(), np.cumsum(sizes)[:-1])
    for view, cursor in zip(seen, cursors, strict=True):
        _list(*view, cursor, True, members, alphas)
    views = np.repeat(np.arange(len(cameras), dtype=np.int32), sizes)
    return _Views(starts, members, alphas, views, *_turn(starts, members, n)), np.stack(carried)


def _blocks(pixels: torch.Tensor) -> np.ndarray:
    """Which blocks, row by row, hold any of ``pixels`` bool [H, W]."""
    height, width = pixels.shape
    padded = np.pad(pixels.numpy(), ((0, -height % BLOCK), (0, -width % BLOCK)))
    rows, columns = padded.shape[0] // BLOCK, padded.shape[1] // BLOCK
    return padded.reshape(rows, BLOCK, columns, BLOCK).any((1, 3)).ravel()


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _list(splats, boxes, bins, width, height, alpha_max, cursors, write, members, alphas):
    """Move the cursor of every block on by its entries, and ``write`` them where it passes.

    A block has an entry for all that the rasteriser looks at there.
    """
    across = -(-width // BLOCK)
    nothing = np.empty((len(splats), 0), np.float32)
    most = fullest(bins)
    for share in numba.prange(SHARES):
        work = make_workspace(most, 0)
        for tile in range(share, bins.across * bins.down, SHARES):
            left, top = load_tile(tile, bins, splats, boxes, nothing, work)
            for block in range(TILE_BLOCKS):
                x0, y0 = left + block % BLOCKS_ACROSS * BLOCK, top + block // BLOCKS_ACROSS * BLOCK
                if x0 >= width or y0 >= height:
                    continue
                place = y0 // BLOCK * across + x0 // BLOCK
                count = work.counts[block]
                if write:
                    listed = bins.entries[bins.starts[tile] :]
                    _write(block, count, work, alpha_max, width - x0, height - y0, cursors[place],
                           listed, members, alphas)  # fmt: skip
                cursors[place] += count


@numba.njit(cache=True)
def _write(block, count, work, alpha_max, wide, tall, entry, splats, members, alphas):
    """Write the entries of a block, of which ``wide`` by ``tall`` pixels are in the image."""
    inside = vwhere(vload(ACROSS, 0) < np.float32(wide), np.float32(1), vzero())
    inside = vwhere(vload(DOWN, 0) < np.float32(tall), inside, np.float32(0))
    first = block * (len(work.lists) // TILE_BLOCKS)
    listed = work.lists[first : first + count].copy()
    # Alone in its list, a splat has its alpha for a weight. (In the parallel function Numba would
    # remove the call, as nothing uses its results.)
    work.counts[block] = 1
    for k in listed:
        work.lists[first] = k
        weigh_block(block, work, alpha_max, np.float32(0))
        members[entry] = splats[k]
        vstore(alphas, entry * LANES, inside * vload(work.weights, 0))
        entry += 1


@numba.njit(cache=True)
def _turn(starts, members, n):
    begins = np.zeros(n + 1, np.int64)
    for member in members:
        begins[member + 1] += 1
    begins = np.cumsum(begins)
    cursors = begins[:-1].copy()
    blocks = np.empty(len(members), np.int32)
    for block in range(len(starts) - 1):
        for entry in range(starts[block], starts[block + 1]):
            member = members[entry]
            blocks[cursors[member]] = block
            cursors[member] += 1
    return begins, blocks


@numba.njit(cache=True)
def _composite_all(views, values, finished):
    """Light left and values, float32 [blocks, 1 + C, LANES], and the sum of each one's weights."""
    n, channels = values.shape[1:]
    flats = values.reshape(len(values), n * channels)
    found = np.empty((len(views.views), 1 + channels, LANES), np.float32)
    sums = found.reshape(found.size)
    total = np.zeros(n)
    kept = np.ones(n, np.bool_)
    work = _work(views)
    for block in range(len(found)):
        count, light = _weigh(block, -1, views, kept, finished, work)
        at = block * (1 + channels) * LANES
        vstore(sums, at, light)
        for c in range(0, channels, GROUP):
            p, q, r, s = _sum(count, work, flats[views.views[block]], channels, c)
            vstore(sums, at + (c + 1) * LANES, p)
            vstore(sums, at + (c + 2) * LANES, q)
            vstore(sums, at + (c + 3) * LANES, r)
            vstore(sums, at + (c + 4) * LANES, s)
        for j in range(count):
            total[work.drawn[j]] += vsum(vload(work.weights, j * LANES))
    return found, total


@numba.njit(cache=True)
def _drop(order, views, values, reference, frozen, finished, limit):
    """Which Gaussians stay, bool [N]: all that, in ``order``, cannot go."""
    n, channels = values.shape[1:]
    flats = values.reshape(len(values), n * channels)
    sums = reference.reshape(reference.size)
    kept = np.ones(n, np.bool_)
    work = _work(views)
    for i in order:
        needed = False
        for at in range(views.begins[i], views.begins[i + 1]):
            block = views.blocks[at]
            needed = frozen[block] or _changed(
                block, i, views, kept, flats[views.views[block]], finished, sums, limit, work
            )
            if needed:
                break
        kept[i] = needed
    return kept


class _Work(NamedTuple):
    """What is drawn in a block: Gaussians and weights."""

    drawn: np.ndarray
    weights: np.ndarray


@numba.njit(cache=True)
def _work(views):
    most = 1
    for block in range(len(views.views)):
        most = max(most, views.starts[block + 1] - views.starts[block])
    return _Work(np.empty(most, np.int32), np.empty(most * LANES, np.float32))


@numba.njit(cache=True)
def _changed(block, without, views, kept, flat, finished, sums, limit, work):
    """Whether a block is further than ``limit`` from its picture once ``without`` is gone too."""
    channels = len(flat) // len(kept)
    at = block * (1 + channels) * LANES
    count, light = _weigh(block, without, views, kept, finished, work)
    if _apart(light, sums, at, limit):
        return True
    for c in range(0, channels, GROUP):
        p, q, r, s = _sum(count, work, flat, channels, c)
        at += LANES
        if _apart(p, sums, at, limit) or _apart(q, sums, at + LANES, limit):
            return True
        at += 2 * LANES
        if _apart(r, sums, at, limit) or _apart(s, sums, at + LANES, limit):
            return True
        at += LANES
    return False


@numba.njit(cache=True)
def _apart(found, sums, at, limit):
    change = found - vload(sums, at)
    return vany(change > limit) or vany(change < -limit)


@numba.njit(cache=True)
def _weigh(block, without, views, kept, finished, work):
    """As the rasteriser does it: how many Gaussians are drawn, and the light that is left."""
    light = vzero() + np.float32(1)
    count = 0
    for entry in range(views.starts[block], views.starts[block + 1]):
        member = views.members[entry]
        if kept[member] and member != without:
            alpha = vload(views.alphas, entry * LANES)
            weight = vwhere(light >= finished, alpha * light, np.float32(0))
            vstore(work.weights, count * LANES, weight)
            work.drawn[count] = member
            light = light - weight
            count += 1
    return count, light


@numba.njit(cache=True)
def _sum(count, work, flat, channels, c):
    p, q, r, s = vzero(), vzero(), vzero(), vzero()
    for j in range(count):
        weight = vload(work.weights, j * LANES)
        at = np.int64(np.uint32(work.drawn[j])) * channels + c
        p = p + weight * flat[at]
        q = q + weight * flat[at + 1]
        r = r + weight * flat[at + 2]
        s = s + weight * flat[at + 3]
    return p, q, r, s
