"""Leave out and merge Gaussians that some views do not need, and say by how much the views change.

Gaussians are tried one by one: dropped, the faintest first, and merged with a neighbour of like
colour. The pixels that a change touches are composited again, with all that changed before it, and
compared with what they were at first. So no error is estimated, none adds up unseen, and errors of
opposite sign cancel. At last the views are drawn; where they show more after all, what touches that
place is as it was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial.transform import Rotation

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians, covariances
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.simd import LANES, vany, vload, vstore, vsum, vwhere, vzero
from slgaussian.kernels.work_sharing import share, take
from slgaussian.rasterize.api import rasterize
from slgaussian.rasterize.cpu import GEOMETRY, as_kernels_take_them
from slgaussian.rasterize.harmonics import colors
from slgaussian.rasterize.likest import likest
from slgaussian.rasterize.lists import (
    NOBODY,
    composite_all,
    falloff,
    list_views,
    replace_in,
    without,
)
from slgaussian.rasterize.project import U, V, Z, eye_of, project, project_moments
from slgaussian.rasterize.render_settings import Settings, find_settings
from slgaussian.rasterize.tiles import BLOCK
from slgaussian.scene import Camera

NOISE = 2e-6
"""What is left of the tolerance to rounding. Measured: 5e-7."""

NEIGHBOURS = 3
"""How many of those near and most like it each Gaussian is tried with."""

FAR = 4.0
"""Standard deviations of the smaller one, between centres, past which two are not tried."""

UNLIKE = 16.0
"""Tolerances, between values, past which two are not tried."""

SLACK = np.float32(1e-5)
"""More than rounding moves what one Gaussian does to a pixel."""

WORTH = 0.01
"""Of those left, what has to be merged in one go for another one to be worth it."""

SHARE = 256
"""Pairs that a thread takes at a time."""

SPREAD = 1.2
"""Times the covariance that has the moments of the two: the one in their place cannot be more
opaque than opaque, and has to be wider. Of 0.85, 1, 1.2, 1.5 and 2, this leaves fewest."""

MOST_BLOCKS = 512
"""A pair that touches more blocks of pixels than this is not merged."""

BATCH = 1 << 16


@dataclass(frozen=True, eq=False)
class Pruned:
    """What is left, and what that changed.

    Attributes
    ----------
    gaussians : Gaussians
        Those that stay, in their order; into some of them others are merged. ``source`` is theirs.
    kept : int64 [M]
        Their indices among those that were given.
    error : float
        The greatest change of any channel of any pixel of the given views, over black or white,
        measured by rendering them before and after; at most the tolerance.
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
    """Drop and merge Gaussians while no pixel of the given views changes by over ``tolerance``.

    What counts is what is drawn: colour, over black and over white, seen from each camera, and
    ``features``, if there are any. Depth may move where things of one colour lie behind one
    another. What no given view sees changes none of their pixels, and goes; other views may change
    by more than the tolerance: give all that matter.

    Parameters
    ----------
    gaussians : Gaussians
    cameras : sequence of Camera
        The views to keep. Each takes about 90 bytes for every block of 4x4 pixels that a Gaussian
        touches: 175 MB at 416x576 with a Gaussian a pixel of two such views.
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
    scene = _Scene(gaussians, cameras, settings, tolerance)
    scene.drop()
    scene.merge()
    grown = rounds = 0
    while True:
        left = scene.gaussians[scene.kept]
        after = [_draw(left, camera, settings) for camera in cameras]
        changes = [(a - b).abs().amax(2) for a, b in zip(after, before, strict=True)]
        error = max(float(change.max()) for change in changes)
        if error <= tolerance:
            return Pruned(left, scene.kept.nonzero()[:, 0], error)
        scene.take_back([change.numpy() > tolerance for change in changes], grown)
        grown = 2 * grown if grown else rounds // 8
        rounds += 1


def _values(gaussians: Gaussians, camera: Camera) -> torch.Tensor:
    """The channels that count: float32 [N, C]; the first three are colour."""
    colour = colors(gaussians, camera)
    carried = [] if gaussians.features is None else [gaussians.features]
    return torch.cat([colour, *carried], 1).detach().to("cpu", torch.float32)


def _draw(gaussians: Gaussians, camera: Camera, settings: Settings) -> torch.Tensor:
    """The channels that count, and colour over white: float32 [H, W, C + 3]."""
    values = _values(gaussians, camera)
    with torch.no_grad():
        drawn = rasterize(gaussians, values, camera, backend="cpu", settings=settings)
    return torch.cat([drawn.values, drawn.values[..., :3] + 1 - drawn.alpha[..., None]], 2)


class _Scene:
    """Gaussians that change, and the lists of all views that change with them.

    Attributes
    ----------
    given, gaussians : Gaussians
        As they were, and as many of which into some others are merged.
    kept : bool [N]
    into : int64 [N]
        What each is merged into; itself where it is not.
    lists : slgaussian.rasterize.lists.Lists
    values : float32 [V, N, C]
    """

    def __init__(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        settings: Settings,
        tolerance: float,
    ) -> None:
        gaussians, _ = as_kernels_take_them(gaussians, torch.zeros(len(gaussians), 0))
        copies = {name: tensor.detach().cpu().clone() for name, tensor in gaussians.items()}
        self.given, self.gaussians = gaussians, replace(gaussians, **copies)
        self.kept = torch.ones(len(gaussians), dtype=torch.bool)
        self.into = np.arange(len(gaussians))
        self.eyes = [eye_of(camera, settings) for camera in cameras]
        geometry = [getattr(self.gaussians, name).numpy() for name in GEOMETRY]
        self.lists = list_views(geometry, self.eyes, settings.alpha_max)
        self.values = np.stack([_values(self.gaussians, camera).numpy() for camera in cameras])
        self.covariances = _covariances(self.gaussians)
        self.tolerance = tolerance
        self.limits = _Limits(
            np.float32(max(0.0, tolerance - NOISE)),
            np.float32(max(settings.pass_min, 1e-30)),
            np.float32(settings.alpha_min),
            np.float32(settings.alpha_max),
        )

    def drop(self) -> None:
        """Drop all that can go, the faintest first."""
        finished, limit = self.limits.finished, self.limits.change
        # Twice the limit, as what others changed the other way is undone.
        self.reference, weight, needed = composite_all(
            self.lists, self.values, finished, 2 * limit + SLACK
        )
        order = np.flatnonzero(~needed)
        order = order[np.argsort(weight[order], kind="stable")]
        _drop(order, self.lists, self.values, self.reference, self.limits, self.kept.numpy())

    def merge(self) -> None:
        """Merge neighbours, the most alike first, and the merged again while that pays."""
        changed, merged = np.ones(len(self.kept), np.bool_), len(self.kept)
        while self.tolerance > 0 and merged > WORTH * int(self.kept.sum()) > 0:
            pairs = self._alike(changed)
            changed[:] = False
            for first in range(0, len(pairs), BATCH):
                batch = pairs[first : first + BATCH]
                batch = batch[~changed[batch].any(1)]
                # Neighbours after one another, as they have blocks in common.
                self._merge(batch[np.argsort(batch[:, 0], kind="stable")], changed)
            merged = int(changed.sum()) // 2

    def _alike(self, changed: np.ndarray) -> np.ndarray:
        """Pairs to try, int64 [P, 2], of which at least one ``changed``, the most alike first."""
        live = self.kept.nonzero()[:, 0].numpy()
        means, widest = self.gaussians.means.numpy(), self.gaussians.scales.numpy().max(1)
        values = np.concatenate([own[live] for own in self.values], 1)
        unlike, asked = np.float32(UNLIKE * self.tolerance), np.flatnonzero(changed[live])
        found, costs = likest(
            asked, means[live], widest[live], values, NEIGHBOURS, np.float32(FAR), unlike
        )
        row, k = np.nonzero(found >= 0)
        i, j = asked[row], found[row, k]
        # Of two that found each other, one pair.
        other = np.full(len(live), -1)
        other[asked] = np.arange(len(asked))
        new = (i < j) | (other[j] < 0) | ~(found[other[j]] == i[:, None]).any(1)
        i, j, costs = i[new], j[new], costs[row, k][new]
        pairs = np.stack([np.minimum(i, j), np.maximum(i, j)], 1)
        return live[pairs[np.argsort(costs, kind="stable")]]

    def _merge(self, pairs: np.ndarray, changed: np.ndarray) -> None:
        """Try pairs in their order; a Gaussian that ``changed`` is not tried again."""
        if not len(pairs):
            return
        mine = self.gaussians
        fraction, means, covariances = _moments(
            pairs, mine.means.numpy(), mine.scales.numpy(), mine.opacities.numpy(), self.covariances
        )
        seen = [project_moments(means, covariances, eye) for eye in self.eyes]
        splats, boxes = (np.stack(arrays) for arrays in zip(*seen, strict=True))
        scene = self.lists, self.values, self.reference, self.limits
        good = np.ones(len(pairs), bool)
        share(_promising, -(-len(pairs) // SHARE), pairs, fraction, splats, *scene, good)
        pairs, fraction, means, covariances = (
            array[good] for array in (pairs, fraction, means, covariances)
        )
        splats, boxes = splats[:, good], boxes[:, good]
        opacities, shifts = _merge(
            pairs, fraction, splats, boxes, *scene, self.kept.numpy(), changed
        )
        done = opacities > 0
        i, j = torch.from_numpy(pairs[done]).T
        self.into[pairs[done, 0]] = pairs[done, 1]
        self.covariances[pairs[done, 1]] = covariances[done]
        shape = _shape_of(covariances[done])
        for name, array in zip(GEOMETRY, (means[done], *shape, opacities[done]), strict=True):
            getattr(mine, name)[j] = torch.from_numpy(array)
        part, shift = torch.from_numpy(fraction[done])[:, None], torch.from_numpy(shifts[done])
        mine.sh[j] = part[..., None] * mine.sh[i] + (1 - part[..., None]) * mine.sh[j]
        mine.sh[j, 0] += shift[:, :3] / SH_C0
        if mine.features is not None:
            mine.features[j] = (
                part * mine.features[i] + (1 - part) * mine.features[j] + shift[:, 3:]
            )

    def take_back(self, over: Sequence[np.ndarray], grown: int) -> None:
        """Leave as it was given what touches pixels ``over`` bool [H, W] or those ``grown`` off.

        What is merged with it, too: so this may be too much elsewhere, and is to be repeated.
        """
        roots = self.into
        while (further := roots[roots] != roots).any():
            roots = np.where(further, roots[roots], roots)
        hit = np.zeros(len(roots), np.bool_)
        for where, eye in zip(over, self.eyes, strict=True):
            if grown:
                where = ndimage.binary_dilation(where, np.ones((3, 3)), grown)
            sums = np.pad(where.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
            for gaussians in (self.given, self.gaussians):
                geometry = [getattr(gaussians, name).detach().numpy() for name in GEOMETRY]
                _, boxes, _ = project(geometry, np.empty((len(hit), 0), np.float32), eye)
                left, right, top, bottom = boxes.T
                inside = sums[bottom, right] - sums[top, right] - sums[bottom, left]
                hit |= inside + sums[top, left] > 0
        back = np.isin(roots, roots[hit])
        back_rows = torch.from_numpy(back)
        for name, tensor in self.given.items():
            getattr(self.gaussians, name)[back_rows] = tensor.detach()[back_rows]
        self.kept[back_rows] = True
        self.into[back] = np.flatnonzero(back)


def _covariances(gaussians: Gaussians) -> np.ndarray:
    """Float64 [N, 3, 3]."""
    double = {name: getattr(gaussians, name).double() for name in ("scales", "quats")}
    found: np.ndarray = covariances(replace(gaussians, **double)).numpy()
    return found


def _shape_of(covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scales and quaternions float32 of covariances float64 [N, 3, 3]."""
    variances, axes = np.linalg.eigh(covariances)
    axes *= np.sign(np.linalg.det(axes))[:, None, None]
    quats = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    return np.sqrt(np.maximum(variances, 0)).astype(np.float32), quats.astype(np.float32)


@kernel
def _moments(pairs, means, scales, opacities, covariances):
    """The part of each pair's first one, and the mean and covariance of what takes their place.

    Float32 [P], float32 [P, 3], float64 [P, 3, 3].
    """
    parts, mixed = np.empty(len(pairs), np.float32), np.empty((len(pairs), 3), np.float32)
    made = np.empty((len(pairs), 3, 3))
    for p in range(len(pairs)):
        i, j = pairs[p]
        of_i, of_j = _area(scales[i], opacities[i]), _area(scales[j], opacities[j])
        part = of_i / max(of_i + of_j, 1e-60)
        parts[p] = part
        for k in range(3):
            mixed[p, k] = part * means[i, k] + (1 - part) * means[j, k]
            for m in range(3):
                within = part * covariances[i, k, m] + (1 - part) * covariances[j, k, m]
                apart = np.float64(means[i, k] - means[j, k]) * (means[i, m] - means[j, m])
                made[p, k, m] = SPREAD * (within + part * (1 - part) * apart)
    return parts, mixed, made


@kernel
def _area(scales, opacity):
    """Opacity times the two greater scales."""
    a, b, c = np.float64(scales[0]), np.float64(scales[1]), np.float64(scales[2])
    return opacity * max(max(a * b, max(b * c, a * c)), 1e-30)


class _Limits(NamedTuple):
    change: np.float32
    """The greatest change of a channel."""
    finished: np.float32
    """The light below which a pixel takes no more."""
    alpha_min: np.float32
    alpha_max: np.float32


class _Room(NamedTuple):
    """Room to try a change in: its blocks, and what is there."""

    blocks: np.ndarray
    alphas: np.ndarray
    sums: np.ndarray
    mixed: np.ndarray
    drawn: np.ndarray
    weights: np.ndarray


@kernel
def _room(lists, blocks, views, channels):
    most = lists.rooms.max() if len(lists.rooms) else 0
    return _Room(
        np.empty(blocks, np.int64),
        np.empty(blocks * LANES, np.float32),
        np.empty(blocks * (3 + 2 * channels) * LANES, np.float32),
        np.empty((views, channels), np.float32),
        np.empty(most, np.int32),
        np.empty(most * LANES, np.float32),
    )


@kernel
def _drop(order, lists, values, reference, limits, kept):
    """Drop, in ``order``, all that can go."""
    views, _, channels = values.shape
    nothing, room = np.zeros(channels, np.float32), _room(lists, 1, views, channels)
    for i in order:
        places = lists.places[lists.begins[i] : lists.ends[i]]
        needed = False
        for block in places:
            without(block, i, NOBODY, np.float32(np.inf), lists, values[lists.views[block]],
                    limits.finished, room.drawn, room.weights, room.sums, 0)  # fmt: skip
            if _strays(block, room.sums, 0, vzero(), vzero(), nothing, reference, limits.change):
                needed = True
                break
        if not needed:
            kept[i] = False
            for block in places:
                replace_in(block, i, NOBODY, vzero(), False, np.float32(0), lists)


@kernel
def _strays(block, sums, at, alpha, weight, own, reference, limit):
    """Whether a block is further than ``limit`` from its picture, over black or over white."""
    truth = reference[block].reshape(reference[block].size)
    passes = np.float32(1) + vzero() - alpha
    darker = vload(sums, at + LANES) * passes - vload(truth, 0)
    for c in range(len(own)):
        to = at + (3 + 2 * c) * LANES
        change = vload(sums, to) + passes * vload(sums, to + LANES) + weight * own[c]
        change = change - vload(truth, (1 + c) * LANES)
        if _beyond(change, limit) or (c < 3 and _beyond(change + darker, limit)):
            return True
    return False


@kernel
def _beyond(change, limit):
    return vany(change > limit) or vany(change < -limit)


@kernel
def _merge(pairs, fraction, splats, boxes, lists, values, reference, limits, kept, changed):
    """Put one Gaussian in the place of two where no pixel changes by more than the limit.

    Its opacity is what fits the weights of the two, its values what fits the pictures, by least
    squares over the pixels it touches: both are linear there.

    Parameters
    ----------
    pairs, fraction : int64 [P, 2], float32 [P]
        Gaussians i and j, and the part of i in the one that takes the place of j.
    splats, boxes : float64 [V, P, 8], int32 [V, P, 4]
        That one in each view, with opacity 1.

    Returns
    -------
    opacities : float32 [P]
        0 where nothing is merged.
    shifts : float32 [P, C]
        What is added to the mixed values.
    """
    views, _, channels = values.shape
    opacities = np.zeros(len(pairs), np.float32)
    shifts = np.zeros((len(pairs), channels), np.float32)
    room = _room(lists, MOST_BLOCKS, views, channels)
    blocks, alphas, mixed = room.blocks, room.alphas, room.mixed
    marks = np.full(len(lists.starts), -1, np.int64)
    for p in range(len(pairs)):
        i, j = pairs[p]
        if changed[i] or changed[j] or not (kept[i] and kept[j]):
            continue
        count = _touched(i, j, boxes[:, p], lists, p, marks, blocks)
        if count == 0 or lists.used[0] + count > len(lists.places):
            continue
        opacity = _try(count, i, j, fraction[p], splats[:, p], lists, values, reference, limits,
                       limits.change, room, shifts[p])  # fmt: skip
        if opacity == 0:
            continue
        lists.begins[j] = lists.used[0]
        for k in range(count):
            block, alpha = blocks[k], vload(alphas, k * LANES)
            has = vany(alpha > np.float32(0))
            z = np.float32(splats[lists.views[block], p, Z])
            replace_in(block, i, j, alpha, has, z, lists)
            if has:
                lists.places[lists.used[0]] = block
                lists.used[0] += 1
        lists.ends[j] = lists.used[0]
        for view in range(views):
            lists.z[view, j] = splats[view, p, Z]
            values[view, j] = mixed[view]
        kept[i], changed[i], changed[j] = False, True, True
        opacities[p] = opacity
    return opacities, shifts


@kernel
def _promising(counter, pairs, fraction, splats, lists, values, reference, limits, good):
    """Write which pairs may do, by the block in the middle of each view: few others do not."""
    views, _, channels = values.shape
    start = take(counter) * SHARE
    if start >= len(pairs):
        return
    room, shift = _room(lists, 1, views, channels), np.empty(channels, np.float32)
    while start < len(pairs):
        for p in range(start, min(start + SHARE, len(pairs))):
            i, j = pairs[p]
            for view in range(views):
                room.blocks[0] = _middle(splats[view, p], lists.sizes[view])
                if room.blocks[0] < 0:
                    continue
                if not _try(1, i, j, fraction[p], splats[:, p], lists, values, reference,
                            limits, limits.change, room, shift):  # fmt: skip
                    good[p] = False
                    break
        start = take(counter) * SHARE


@kernel
def _try(count, i, j, part, splats, lists, values, reference, limits, most, room, shift):
    """Fit one in the place of i and j to the first ``count`` blocks of ``room``.

    Returns its opacity; 0 where it would change a pixel by more than ``most``. Writes its alphas
    and values into ``room``, and to ``shift`` what these have beside a mixture.
    """
    stride = (3 + 2 * values.shape[2]) * LANES
    for k in range(count):
        block, view = room.blocks[k], lists.views[room.blocks[k]]
        if lists.counts[block] == lists.rooms[block]:
            return np.float32(0)
        vstore(room.alphas, k * LANES, falloff(block, splats[view], lists))
        without(block, i, j, np.float32(splats[view, Z]), lists, values[view], limits.finished,
                room.drawn, room.weights, room.sums, k * stride)  # fmt: skip
    opacity = _opacity(count, stride, reference, room)
    if not opacity > limits.alpha_min:
        return np.float32(0)
    for view in range(len(values)):
        for c in range(values.shape[2]):
            mine = values[view, j, c]
            room.mixed[view, c] = mine + part * (values[view, i, c] - mine)
    _shift(count, opacity, stride, lists, reference, limits, room, shift)
    for k in range(count):
        block, alpha = room.blocks[k], vload(room.alphas, k * LANES)
        weight, own = vload(room.sums, k * stride) * alpha, room.mixed[lists.views[block]]
        if _strays(block, room.sums, k * stride, alpha, weight, own, reference, most):
            return np.float32(0)
    return opacity


@kernel
def _middle(splat, size):
    """The block of a view that holds the middle of a splat; -1 where it is outside."""
    width, height, across, first = size
    if not (0 <= splat[U] < width and 0 <= splat[V] < height):
        return -1
    return first + np.int64(splat[V]) // BLOCK * across + np.int64(splat[U]) // BLOCK


@kernel
def _opacity(count, stride, reference, room):
    """With which one in the place of two lets as much light pass, by least squares."""
    up = down = np.float32(0)
    for k in range(count):
        light = vload(room.sums, k * stride + LANES)
        taken = light * vload(room.alphas, k * LANES)
        up += vsum(taken * (light - vload(_flat(reference, room.blocks[k]), 0)))
        down += vsum(taken * taken)
    return min(up / down, np.float32(1)) if down > 0 else np.float32(0)


@kernel
def _flat(reference, block):
    return reference[block].reshape(reference[block].size)


@kernel
def _shift(count, opacity, stride, lists, reference, limits, room, shift):
    """Move the values by what fits the pictures, by least squares; shapes become alphas."""
    views, channels = room.mixed.shape
    shift[:] = 0
    down = np.float32(0)
    for k in range(count):
        at, view = k * stride, lists.views[room.blocks[k]]
        truth = _flat(reference, room.blocks[k])
        alpha = vload(room.alphas, k * LANES) * opacity
        alpha = vwhere(alpha >= limits.alpha_min, alpha, vzero())
        alpha = vwhere(alpha < limits.alpha_max, alpha, limits.alpha_max)
        light = vload(room.sums, at)
        light = vwhere(light >= limits.finished, light, vzero())
        vstore(room.alphas, k * LANES, alpha)
        vstore(room.sums, at, light)
        weight = light * alpha
        down += vsum(weight * weight)
        for c in range(channels):
            to = at + (3 + 2 * c) * LANES
            past = vload(room.sums, to + LANES)
            missing = vload(truth, (1 + c) * LANES) - vload(room.sums, to) - past + alpha * past
            shift[c] += vsum(weight * (missing - weight * room.mixed[view, c]))
    for c in range(channels):
        shift[c] = shift[c] / down if down > 0 else np.float32(0)
        for view in range(views):
            if c < 3:  # no colour is below zero
                shift[c] = max(shift[c], -room.mixed[view, c])
        for view in range(views):
            room.mixed[view, c] += shift[c]


@kernel
def _touched(i, j, boxes, lists, mark, marks, blocks):
    """Write the ``blocks`` that i, j or what has the pixel ``boxes`` [V, 4] touches, each once.

    Returns how many; 0 if they are too many.
    """
    count = 0
    for who in (i, j):
        for at in range(lists.begins[who], lists.ends[who]):
            count = _mark(lists.places[at], mark, marks, blocks, count)
    for view in range(len(boxes)):
        x0, x1, y0, y1 = boxes[view]
        if x1 <= x0 or y1 <= y0:
            continue
        _, _, across, first = lists.sizes[view]
        for y in range(y0 // BLOCK, (y1 - 1) // BLOCK + 1):
            for x in range(x0 // BLOCK, (x1 - 1) // BLOCK + 1):
                count = _mark(first + y * across + x, mark, marks, blocks, count)
    return max(count, 0)


@kernel
def _mark(block, mark, marks, blocks, count):
    if count < 0 or marks[block] == mark:
        return count
    if count == len(blocks):
        return -1
    marks[block] = mark
    blocks[count] = block
    return count + 1
