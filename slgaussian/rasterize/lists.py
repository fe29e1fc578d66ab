"""What every pixel of several views is composited from, in lists from which can be taken.

Lists are kept for blocks of 4x4 pixels, as the rasteriser draws them. They say what a change would
do to a picture exactly, at the price of compositing the blocks it touches and no others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vabs, vany, vexp2, vload, vstore, vsum, vwhere, vzero
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.blend import alpha_of
from slgaussian.rasterize.project import CUT, POWER, ROOT, ROW_ROOT, SLOPE, Eye, U, V, Z, project
from slgaussian.rasterize.tiles import (
    ACROSS,
    BLOCK,
    DOWN,
    STRIP,
    TILE_BLOCKS,
    bin_splats,
    corner_of,
    fullest,
    load_tile,
    make_workspace,
    strips_of,
)

SPARE = 4
"""How many more entries a block has room for than it starts with."""

NOBODY = -1

PATIENCE = 4
"""Gaussians composited in a row before looking whether any of the pixels lets light through."""


class Lists(NamedTuple):
    """The lists of all blocks of all views, and where each Gaussian is in them.

    Attributes
    ----------
    starts, counts, rooms : int64 [blocks]
        Block b has the entries ``starts[b] : starts[b] + counts[b]``, front to back, and room for
        ``rooms[b]``.
    members : int32 [room of all]
        The Gaussian of each entry.
    alphas : float32 [room of all * LANES]
        Zero outside the image.
    views, left, top : int32 [blocks]
        The view each block belongs to, and its first pixel there.
    sizes : int64 [V, 4]
        Width, height, blocks across, and first block of each view.
    z : float32 [V, N]
    begins, ends : int64 [N]
        Gaussian i is in the blocks ``places[begins[i] : ends[i]]``.
    places : int32 [pool]
    used : int64 [1]
        How much of the pool is taken; who moves to other blocks gets a new part of it.
    """

    starts: np.ndarray
    counts: np.ndarray
    rooms: np.ndarray
    members: np.ndarray
    alphas: np.ndarray
    views: np.ndarray
    left: np.ndarray
    top: np.ndarray
    sizes: np.ndarray
    z: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    places: np.ndarray
    used: np.ndarray


def list_views(geometry: Sequence[np.ndarray], eyes: Sequence[Eye], alpha_max: float) -> Lists:
    """The lists of Gaussians in all views.

    Parameters
    ----------
    geometry : float32 [N, 3], [N, 3], [N, 4], [N]
        Means, scales, quaternions and opacities.
    eyes : sequence of Eye
    alpha_max : float
    """
    n = len(geometry[0])
    nothing = np.empty((n, 0), np.float32)
    seen = [project(geometry, nothing, eye)[:2] for eye in eyes]
    view: list[np.ndarray] = []
    left, top, sizes, first = [], [], [], 0
    for number, eye in enumerate(eyes):
        across, down = -(-eye.width // BLOCK), -(-eye.height // BLOCK)
        y, x = np.indices((down, across)).reshape(2, -1) * BLOCK
        sizes.append((eye.width, eye.height, across, first))
        first += across * down
        view.append(np.full(across * down, number))
        left.append(x)
        top.append(y)
    boxes = np.stack([own for _, own in seen])
    counts, begins, places = _touch(boxes, np.array(sizes), first)
    rooms = counts + SPARE
    starts = np.cumsum(rooms) - rooms
    members = np.empty(rooms.sum(), np.int32)
    alphas = np.empty(rooms.sum() * LANES, np.float32)
    for (width, height, _, first), (splats, own) in zip(sizes, seen, strict=True):
        bins = bin_splats(own, width, height)
        share(_write, strips_of(bins), splats, own, bins, width, height, np.float32(alpha_max),
              starts[first:], members, alphas)  # fmt: skip
    return Lists(
        starts, counts, rooms, members, alphas, _joined(view), _joined(left), _joined(top),
        np.array(sizes), np.array([splats[:, Z] for splats, _ in seen], np.float32),
        begins[:-1].copy(), begins[1:].copy(),
        # Room for everybody to move three times.
        np.concatenate([places, np.empty(3 * len(places) + 64, np.int32)]),
        np.array([len(places)]),
    )  # fmt: skip


def _joined(columns: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate(columns).astype(np.int32)


@kernel
def _touch(boxes, sizes, blocks):
    """How many each block lists, where the blocks of each Gaussian begin, and these."""
    views, n, _ = boxes.shape
    counts, begins = np.zeros(blocks, np.int64), np.zeros(n + 1, np.int64)
    for i in range(n):
        begins[i + 1] = begins[i]
        for view in range(views):
            x0, x1, y0, y1 = boxes[view, i]
            if x1 > x0 and y1 > y0:
                wide = (x1 - 1) // BLOCK + 1 - x0 // BLOCK
                begins[i + 1] += wide * ((y1 - 1) // BLOCK + 1 - y0 // BLOCK)
    places = np.empty(begins[n], np.int32)
    cursor = 0
    for i in range(n):
        for view in range(views):
            x0, x1, y0, y1 = boxes[view, i]
            if x1 > x0 and y1 > y0:
                for y in range(y0 // BLOCK, (y1 - 1) // BLOCK + 1):
                    for x in range(x0 // BLOCK, (x1 - 1) // BLOCK + 1):
                        block = sizes[view, 3] + y * sizes[view, 2] + x
                        counts[block] += 1
                        places[cursor] = block
                        cursor += 1
    return counts, begins, places


@kernel
def _write(counter, splats, boxes, bins, width, height, alpha_max, starts, members, alphas):
    """Write the entries of every block of a view: all that the rasteriser looks at there."""
    across = -(-width // BLOCK)
    nothing = np.empty((len(splats), 0), np.float32)
    strip, tiles = take(counter), bins.across * bins.down
    if strip * STRIP >= tiles:
        return
    work = make_workspace(fullest(bins), 0)
    while strip * STRIP < tiles:
        for tile in range(strip * STRIP, min(tiles, (strip + 1) * STRIP)):
            left, top = load_tile(tile, bins, splats, boxes, nothing, work)
            entries = bins.entries[bins.starts[tile] :]
            for block in range(TILE_BLOCKS):
                x0, y0 = corner_of(block, left, top)
                if x0 < width and y0 < height:
                    place = starts[y0 // BLOCK * across + x0 // BLOCK]
                    _write_block(block, work, alpha_max, width - x0, height - y0, place,
                                 entries, members, alphas)  # fmt: skip
        strip = take(counter)


@kernel
def _write_block(block, work, alpha_max, wide, tall, entry, splats, members, alphas):
    """Write the entries of a block, of which ``wide`` by ``tall`` pixels are in the image."""
    first = block * len(work.keys)
    for k in range(first, first + work.counts[block]):
        member = np.uint32(work.lists[k])
        alpha = alpha_of(block, work.local[member], alpha_max)
        members[entry] = splats[member]
        vstore(alphas, entry * LANES, inside(alpha, wide, tall))
        entry += 1


@kernel
def inside(vector, wide, tall):
    """``vector`` in the first ``wide`` by ``tall`` pixels of a block, zero in the others."""
    vector = vwhere(vload(ACROSS, 0) < np.float32(wide), vector, vzero())
    return vwhere(vload(DOWN, 0) < np.float32(tall), vector, vzero())


@kernel
def falloff(block, splat, lists):
    """What the alpha of a splat is in a block, over its opacity: as the rasteriser has it."""
    width, height = lists.sizes[lists.views[block], :2]
    left, top = lists.left[block], lists.top[block]
    y = splat[V] - top - 0.5
    x = splat[U] - left - 0.5 - splat[SLOPE] * y
    root, row_root = splat[ROOT], splat[ROW_ROOT]
    e = vload(ACROSS, 0) * np.float32(root) - np.float32(root * x)
    e = e - vload(DOWN, 0) * np.float32(root * splat[SLOPE])
    d = vload(DOWN, 0) * np.float32(row_root) - np.float32(row_root * y)
    power = np.float32(splat[POWER]) - e * e - d * d
    alpha = vwhere(power >= np.float32(splat[CUT]), vexp2(power), vzero())
    return inside(alpha, width - left, height - top)


@kernel
def without(block, i, j, z, lists, values, finished, drawn, weights, sums, at):
    """Composite a block without Gaussians i and j, in two parts: before and past a place in depth.

    One in their place, with alpha a, then makes of it ``before + a light value + (1 - a) past``.

    Parameters
    ----------
    z : float32
        The depth of that place; of what has the same, all below ``j`` is before it.
    values : float32 [N, C]
        Of the block's view; C is at least 3.
    finished : float32
        The light below which a pixel takes no more.
    drawn, weights : int32 [room], float32 [room * LANES]
        To work in.
    sums : float32
        To it are written, from ``at``, the light at that place, the light that is left, the alpha
        of i and j together; and for each channel what is before and what is past.
    """
    channels = values.shape[1]
    flat = values.reshape(values.size)
    depths = lists.z[lists.views[block]]
    one = vzero() + np.float32(1)
    light, apart = one, one
    p, q, r = vzero(), vzero(), vzero()
    waits, count, split = True, 0, 0
    start = lists.starts[block]
    for entry in range(start, start + lists.counts[block]):
        # Whatever takes the place of i and j lets about as little pass.
        open_ = light * apart >= finished
        if (entry - start) % PATIENCE == 0 and not vany(open_):
            break
        member = lists.members[entry]
        alpha = vload(lists.alphas, entry * LANES)
        if member in (i, j):
            apart = apart - apart * alpha
            continue
        if waits and (depths[member] > z or (depths[member] == z and member > j)):
            waits, split = False, count
            vstore(sums, at, light)
            _keep(p, q, r, sums, at + 3 * LANES)
            p, q, r = vzero(), vzero(), vzero()
        own = vwhere(open_, alpha * light, vzero())
        light = light - own
        value = np.int64(np.uint32(member)) * channels
        p = p + own * flat[value]
        q = q + own * flat[value + 1]
        r = r + own * flat[value + 2]
        drawn[count] = member
        vstore(weights, count * LANES, own)
        count += 1
    if waits:
        split = count
        vstore(sums, at, light)
        _keep(p, q, r, sums, at + 3 * LANES)
        p, q, r = vzero(), vzero(), vzero()
    _keep(p, q, r, sums, at + 4 * LANES)
    vstore(sums, at + LANES, light)
    vstore(sums, at + 2 * LANES, one - apart)
    for c in range(3, channels):
        for half in range(2):
            total = vzero()
            for k in range(split * half, count if half else split):
                value = flat[np.int64(np.uint32(drawn[k])) * channels + c]
                total = total + vload(weights, k * LANES) * value
            vstore(sums, at + (3 + 2 * c + half) * LANES, total)


@kernel
def _keep(p, q, r, sums, at):
    vstore(sums, at, p)
    vstore(sums, at + 2 * LANES, q)
    vstore(sums, at + 4 * LANES, r)


@kernel
def composite_all(lists, values, finished, most):
    """The picture, and who in it has a part.

    Returns
    -------
    picture : float32 [blocks, 1 + C, LANES]
        The light that is left, and values.
    total : float64 [N]
        The sum of each one's weights.
    needed : bool [N]
        Without whom alone some channel of a pixel, over black or white, changes by over ``most``.
    """
    _, n, channels = values.shape
    room = lists.rooms.max() if len(lists.rooms) else 0
    picture = np.zeros((len(lists.starts), 1 + channels, LANES), np.float32)
    flat = picture.reshape(picture.size)
    total, needed = np.zeros(n), np.zeros(n, np.bool_)
    weights = np.empty(room * LANES, np.float32)
    for block in range(len(picture)):
        own, start = values[lists.views[block]], lists.starts[block]
        light, count = vzero() + np.float32(1), lists.counts[block]
        for k in range(count):
            if not vany(light >= finished):
                count = k
                break
            alpha = vload(lists.alphas, (start + k) * LANES)
            weight = vwhere(light >= finished, alpha * light, vzero())
            light = light - weight
            vstore(weights, k * LANES, weight)
        at = block * (1 + channels) * LANES
        vstore(flat, at, light)
        left = light
        for k in range(count - 1, -1, -1):
            member, weight = lists.members[start + k], vload(weights, k * LANES)
            total[member] += vsum(weight)
            # Past what is opaque there is nothing.
            share = vwhere(light > weight * np.float32(1e-6), weight / light, vzero())
            for c in range(channels):
                to = at + (1 + c) * LANES
                past, mine = vload(flat, to), weight * own[member, c]
                vstore(flat, to, past + mine)
                if not needed[member]:
                    change = share * past - mine
                    over = vabs(change) > most
                    if c < 3:
                        needed[member] = vany(vabs(change + share * left) > most)
                    needed[member] = needed[member] or vany(over)
            light = light + weight
    return picture, total, needed


@kernel
def replace_in(block, i, j, alpha, has, z, lists):
    """Take i and j out of a block; where it ``has`` one in place of j, put that in."""
    start = lists.starts[block]
    end = start
    for entry in range(start, start + lists.counts[block]):
        if lists.members[entry] != i and lists.members[entry] != j:
            _move(entry, end, lists)
            end += 1
    if has:
        depths = lists.z[lists.views[block]]
        entry = end
        while entry > start:
            member = lists.members[entry - 1]
            if depths[member] < z or (depths[member] == z and member < j):
                break
            _move(entry - 1, entry, lists)
            entry -= 1
        lists.members[entry] = j
        vstore(lists.alphas, entry * LANES, alpha)
        end += 1
    lists.counts[block] = end - start


@kernel
def _move(entry, to, lists):
    lists.members[to] = lists.members[entry]
    vstore(lists.alphas, to * LANES, vload(lists.alphas, entry * LANES))
