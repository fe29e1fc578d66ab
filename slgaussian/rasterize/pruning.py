"""Leave out and merge Gaussians that some views do not need, and say by how much the views change.

Gaussians are tried one by one: dropped, the faintest first, and merged with a neighbour of like
colour. The pixels that a change touches are composited again, with all that changed before it, and
compared with what they were at first. So no error is estimated, none adds up unseen, and errors of
opposite sign cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from slgaussian.errors import InputError
from slgaussian.gaussians import SH_C0, Gaussians, covariances
from slgaussian.kernels.simd import LANES, vany, vload, vstore, vsum, vwhere, vzero
from slgaussian.rasterize.api import rasterize
from slgaussian.rasterize.cpu import GEOMETRY, as_kernels_take_them, project_checked
from slgaussian.rasterize.harmonics import colors
from slgaussian.rasterize.lists import (
    NOBODY,
    composite,
    falloff,
    light_without,
    list_views,
    replace_in,
)
from slgaussian.rasterize.project import Z, eye_of, project
from slgaussian.rasterize.render_settings import Settings, find_settings
from slgaussian.rasterize.tiles import BLOCK
from slgaussian.scene import Camera

NOISE = 2e-6
"""What is left of the tolerance to rounding. Measured: 5e-7."""

NEIGHBOURS = 6
"""How many of the nearest each Gaussian is tried with."""

FAR = 4.0
"""Standard deviations of the smaller one, between centres, past which two are not tried."""

UNLIKE = 16.0
"""Tolerances, between values, past which two are not tried."""

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
    frozen: np.ndarray | None = None
    while True:
        scene = _Scene(gaussians, cameras, settings, tolerance, frozen)
        scene.drop()
        scene.merge()
        left = scene.gaussians[scene.kept]
        after = [_draw(left, camera, settings) for camera in cameras]
        changes = [(a - b).abs().amax(2) for a, b in zip(after, before, strict=True)]
        error = max(float(change.max()) for change in changes)
        if error <= tolerance:
            return Pruned(left, scene.kept.nonzero()[:, 0], error)
        # Where rounding moved a cut-off, which is a jump. All that such a block draws has to stay,
        # so this ends.
        over = np.concatenate([_blocks(change > tolerance) for change in changes])
        frozen = over if frozen is None else frozen | over


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


def _blocks(pixels: torch.Tensor) -> np.ndarray:
    """Which blocks, row by row, hold any of ``pixels`` bool [H, W]."""
    height, width = pixels.shape
    padded = np.pad(pixels.numpy(), ((0, -height % BLOCK), (0, -width % BLOCK)))
    rows, columns = padded.shape[0] // BLOCK, padded.shape[1] // BLOCK
    return padded.reshape(rows, BLOCK, columns, BLOCK).any((1, 3)).ravel()


class _Scene:
    """Gaussians that change, and the lists of all views that change with them.

    Attributes
    ----------
    gaussians : Gaussians
        As many as were given; into some, others are merged.
    kept : bool [N]
    lists : slgaussian.rasterize.lists.Lists
    values : float32 [V, N, C]
    """

    def __init__(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        settings: Settings,
        tolerance: float,
        frozen: np.ndarray | None,
    ) -> None:
        gaussians, _ = as_kernels_take_them(gaussians, torch.zeros(len(gaussians), 0))
        copies = {name: tensor.detach().cpu().clone() for name, tensor in gaussians.items()}
        self.gaussians = replace(gaussians, **copies)
        self.kept = torch.ones(len(gaussians), dtype=torch.bool)
        self.eyes = [eye_of(camera, settings) for camera in cameras]
        project_checked(self.gaussians, torch.zeros(len(gaussians), 0), self.eyes[0])
        geometry = [getattr(self.gaussians, name).numpy() for name in GEOMETRY]
        self.lists = list_views(geometry, self.eyes, settings.alpha_max)
        self.values = np.stack([_values(self.gaussians, camera).numpy() for camera in cameras])
        self.tolerance = tolerance
        blocks = len(self.lists.starts)
        self.frozen = np.zeros(blocks, np.bool_) if frozen is None else frozen
        self.limits = _Limits(
            np.float32(max(0.0, tolerance - NOISE)),
            np.float32(max(settings.pass_min, 1e-30)),
            np.float32(settings.alpha_min),
            np.float32(settings.alpha_max),
        )
        self.reference, self.weight = _composite_all(self.lists, self.values, self.limits)

    def drop(self) -> None:
        """Drop all that can go, the faintest first."""
        order = np.argsort(self.weight, kind="stable")
        _drop(order, self.lists, self.values, self.reference, self.frozen, self.limits,
              self.kept.numpy())  # fmt: skip

    def merge(self) -> None:
        """Merge neighbours, the most alike first, and the merged again while that pays."""
        changed = np.ones(len(self.kept), np.bool_)
        while self.tolerance > 0 and int(self.kept.sum()) > 1:
            pairs = self._neighbours(changed)
            changed[:] = False
            for first in range(0, len(pairs), BATCH):
                batch = pairs[first : first + BATCH]
                self._merge(batch[~changed[batch].any(1)], changed)
            if changed.sum() < 0.01 * len(changed):
                break

    def _neighbours(self, changed: np.ndarray) -> np.ndarray:
        """Pairs to try, int64 [P, 2], of which at least one ``changed``, the most alike first."""
        live = self.kept.nonzero()[:, 0].numpy()
        means = self.gaussians.means.numpy()
        near = min(NEIGHBOURS + 1, len(live))
        _, found = cKDTree(means[live]).query(means[live], k=near, workers=-1)
        pairs = np.stack([np.repeat(live, near), live[found.ravel()]], 1)
        pairs = np.unique(np.sort(pairs[changed[pairs].any(1)], 1), axis=0)
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        i, j = pairs.T
        widest = self.gaussians.scales.numpy().max(1)
        apart = np.linalg.norm(means[i] - means[j], axis=1)
        apart /= np.maximum(np.minimum(widest[i], widest[j]), 1e-30)
        unlike = np.zeros(len(pairs))
        for values in self.values:
            unlike = np.maximum(unlike, np.abs(values[i] - values[j]).max(1, initial=0))
        unlike /= self.tolerance
        good = (unlike < UNLIKE) & (apart < FAR)
        order = np.argsort((unlike + 4 * apart**2)[good], kind="stable")
        return pairs[good][order]

    def _merge(self, pairs: np.ndarray, changed: np.ndarray) -> None:
        """Try pairs in their order; a Gaussian that ``changed`` is not tried again."""
        if not len(pairs):
            return
        shape, fraction = _join(self.gaussians, pairs)
        solid = np.ones(len(pairs), np.float32)
        nothing = np.empty((len(pairs), 0), np.float32)
        seen = [project(*shape, solid, nothing, eye)[:2] for eye in self.eyes]
        splats, boxes = (np.stack(arrays) for arrays in zip(*seen, strict=True))
        opacities, shifts = _merge(
            pairs, fraction, splats, boxes, self.lists, self.values, self.reference, self.frozen,
            self.limits, self.kept.numpy(), changed,
        )  # fmt: skip
        done = torch.from_numpy(opacities > 0)
        i, j = torch.from_numpy(pairs)[done].T
        mine = self.gaussians
        for name, arrays in zip(GEOMETRY, (*shape, opacities), strict=True):
            getattr(mine, name)[j] = torch.from_numpy(arrays)[done]
        part, shifts = torch.from_numpy(fraction)[done], torch.from_numpy(shifts)[done]
        part = part[:, None]
        mine.sh[j] = part[..., None] * mine.sh[i] + (1 - part[..., None]) * mine.sh[j]
        mine.sh[j, 0] += shifts[:, :3] / SH_C0
        if mine.features is not None:
            mine.features[j] = (
                part * mine.features[i] + (1 - part) * mine.features[j] + shifts[:, 3:]
            )


def _join(gaussians: Gaussians, pairs: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Means, scales and quaternions float32 of a Gaussian a pair, and the first one's fraction."""
    i, j = (gaussians[torch.from_numpy(pairs[:, k].copy())] for k in (0, 1))
    area_i, area_j = (
        one.opacities.double() * one.scales.double().sort(1).values[:, 1:].prod(1).clamp_min(1e-30)
        for one in (i, j)
    )
    fraction = (area_i / (area_i + area_j).clamp_min(1e-60))[:, None]
    apart = i.means.double() - j.means.double()
    means = fraction * i.means.double() + (1 - fraction) * j.means.double()
    covariance_i, covariance_j = (
        covariances(replace(one, scales=one.scales.double(), quats=one.quats.double()))
        for one in (i, j)
    )
    within = fraction[..., None] * covariance_i + (1 - fraction[..., None]) * covariance_j
    between = (fraction * (1 - fraction))[..., None] * apart[:, :, None] * apart[:, None, :]
    variances, axes = np.linalg.eigh((SPREAD * (within + between)).numpy())
    axes *= np.sign(np.linalg.det(axes))[:, None, None]
    quats = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    scales = np.sqrt(np.maximum(variances, 0))
    shape = [array.astype(np.float32) for array in (means.numpy(), scales, quats)]
    return shape, fraction[:, 0].numpy().astype(np.float32)


class _Limits(NamedTuple):
    change: np.float32
    """The greatest change of a channel."""
    finished: np.float32
    """The light below which a pixel takes no more."""
    alpha_min: np.float32
    alpha_max: np.float32


@numba.njit(cache=True)
def _room(lists):
    """Room to composite any block: who is drawn, with which weights."""
    most = lists.rooms.max() if len(lists.rooms) else 0
    return np.empty(most, np.int32), np.empty(most * LANES, np.float32)


@numba.njit(cache=True)
def _composite_all(lists, values, limits):
    """Light left and values, float32 [blocks, 1 + C, LANES], and the sum of each one's weights."""
    _, n, channels = values.shape
    found = np.empty((len(lists.starts), 1 + channels, LANES), np.float32)
    sums = found.reshape(found.size)
    total = np.zeros(n)
    drawn, weights = _room(lists)
    for block in range(len(found)):
        own, at = values[lists.views[block]], block * (1 + channels) * LANES
        composite(block, NOBODY, NOBODY, vzero(), np.float32(0), lists, own, limits.finished,
                  drawn, weights, sums, at)  # fmt: skip
        for k in range(lists.counts[block]):
            total[drawn[k]] += vsum(vload(weights, k * LANES))
    return found, total


@numba.njit(cache=True)
def _drop(order, lists, values, reference, frozen, limits, kept):
    """Drop, in ``order``, all that can go."""
    channels = values.shape[2]
    sums = np.empty((1 + channels) * LANES, np.float32)
    nothing = np.zeros(channels, np.float32)
    drawn, weights = _room(lists)
    for i in order:
        places = lists.places[lists.begins[i] : lists.ends[i]]
        needed = False
        for block in places:
            if frozen[block]:
                needed = True
                break
            composite(block, i, NOBODY, vzero(), np.float32(0), lists, values[lists.views[block]],
                      limits.finished, drawn, weights, sums, 0)  # fmt: skip
            if _strays(block, sums, 0, vzero(), nothing, reference, limits.change):
                needed = True
                break
        if not needed:
            kept[i] = False
            for block in places:
                replace_in(block, i, NOBODY, vzero(), False, np.float32(0), lists)


@numba.njit(cache=True)
def _strays(block, sums, at, weight, own, reference, limit):
    """Whether a block is further than ``limit`` from its picture, over black or over white."""
    truth = reference[block].reshape(reference[block].size)
    darker = vload(sums, at) - vload(truth, 0)
    for c in range(len(own)):
        to = (1 + c) * LANES
        change = vload(sums, at + to) + weight * own[c] - vload(truth, to)
        if _beyond(change, limit) or (c < 3 and _beyond(change + darker, limit)):
            return True
    return False


@numba.njit(cache=True)
def _beyond(change, limit):
    return vany(change > limit) or vany(change < -limit)


@numba.njit(cache=True, error_model="numpy")
def _merge(pairs, fraction, splats, boxes, lists, values, reference, frozen, limits, kept, changed):
    """Put one Gaussian in the place of two where no pixel changes by more than the limit.

    Its opacity is what fits the light that is left behind, its values what fits the pictures, by
    least squares over the pixels it touches: both are linear there.

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
    blocks = np.empty(MOST_BLOCKS, np.int64)
    alphas = np.empty(MOST_BLOCKS * LANES, np.float32)
    ours = np.empty(MOST_BLOCKS * LANES, np.float32)
    stride = (1 + channels) * LANES
    sums = np.empty(MOST_BLOCKS * stride, np.float32)
    mixed = np.empty((views, channels), np.float32)
    drawn, weights = _room(lists)
    marks = np.full(len(lists.starts), -1, np.int64)
    truth = reference.reshape(reference.size)
    for p in range(len(pairs)):
        i, j = pairs[p]
        if changed[i] or changed[j] or not (kept[i] and kept[j]):
            continue
        count = _touched(i, j, boxes[:, p], lists, frozen, p, marks, blocks)
        if count == 0:
            continue

        up = down = 0.0
        for k in range(count):
            block = blocks[k]
            shape = falloff(block, splats[lists.views[block], p], lists)
            vstore(alphas, k * LANES, shape)
            light = light_without(block, i, j, lists)
            vstore(ours, k * LANES, light)
            taken = light * shape
            up += vsum(taken * (light - vload(truth, block * stride)))
            down += vsum(taken * taken)
        opacity = np.float32(min(up / down, 1.0)) if down > 0 else np.float32(0)
        if not opacity > limits.alpha_min:
            continue
        if _dims(count, blocks, alphas, ours, opacity, truth, stride, limits):
            continue

        for view in range(views):
            for c in range(channels):
                mine = values[view, j, c]
                mixed[view, c] = mine + fraction[p] * (values[view, i, c] - mine)
        shifts[p] = 0
        down = 0.0
        for k in range(count):
            block = blocks[k]
            view = lists.views[block]
            alpha = vload(alphas, k * LANES) * opacity
            alpha = vwhere(alpha >= limits.alpha_min, alpha, vzero())
            alpha = vwhere(alpha < limits.alpha_max, alpha, limits.alpha_max)
            weight = composite(
                block, i, j, alpha, np.float32(splats[view, p, Z]), lists, values[view],
                limits.finished, drawn, weights, sums, k * stride,
            )  # fmt: skip
            vstore(alphas, k * LANES, alpha)
            vstore(ours, k * LANES, weight)
            down += vsum(weight * weight)
            for c in range(channels):
                to = (1 + c) * LANES
                missing = vload(truth, block * stride + to) - vload(sums, k * stride + to)
                shifts[p, c] += vsum(weight * (missing - weight * mixed[view, c]))
        for c in range(channels):
            shifts[p, c] = shifts[p, c] / down if down > 0 else np.float32(0)
            for view in range(views):
                if c < 3:  # no colour is below zero
                    shifts[p, c] = max(shifts[p, c], -mixed[view, c])
        mixed += shifts[p]

        fits = lists.used[0] + count <= len(lists.places)
        for k in range(count):
            block = blocks[k]
            weight, own = vload(ours, k * LANES), mixed[lists.views[block]]
            if lists.counts[block] == lists.rooms[block] or _strays(
                block, sums, k * stride, weight, own, reference, limits.change
            ):
                fits = False
                break
        if not fits:
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


@numba.njit(cache=True)
def _dims(count, blocks, shapes, lights, opacity, truth, stride, limits):
    """Whether so much light more or less is left that black or white shows it, whatever is drawn.

    Quickly told, and the reason why most pairs are refused.
    """
    most = np.float32(2) * limits.change + limits.finished
    for k in range(count):
        light = vload(lights, k * LANES)
        left = light - light * vload(shapes, k * LANES) * opacity
        if _beyond(left - vload(truth, blocks[k] * stride), most):
            return True
    return False


@numba.njit(cache=True)
def _touched(i, j, boxes, lists, frozen, mark, marks, blocks):
    """Write the ``blocks`` that i, j or what has the pixel ``boxes`` [V, 4] touches, each once.

    Returns how many; 0 if any is frozen or they are too many.
    """
    count = 0
    for who in (i, j):
        for at in range(lists.begins[who], lists.ends[who]):
            count = _mark(lists.places[at], frozen, mark, marks, blocks, count)
    for view in range(len(boxes)):
        x0, x1, y0, y1 = boxes[view]
        if x1 <= x0 or y1 <= y0:
            continue
        _, _, across, first = lists.sizes[view]
        for y in range(y0 // BLOCK, (y1 - 1) // BLOCK + 1):
            for x in range(x0 // BLOCK, (x1 - 1) // BLOCK + 1):
                count = _mark(first + y * across + x, frozen, mark, marks, blocks, count)
    return max(count, 0)


@numba.njit(cache=True)
def _mark(block, frozen, mark, marks, blocks, count):
    if count < 0 or marks[block] == mark:
        return count
    if frozen[block] or count == len(blocks):
        return -1
    marks[block] = mark
    blocks[count] = block
    return count + 1
