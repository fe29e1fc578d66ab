"""Which views of a clip make a sample: two to look from, some between them to be judged in.

Two context views should share enough to be matched and differ enough to show depth; neither they
nor the targets may be blurred or badly exposed. A clip gives as many samples as fit beside each
other without sharing a frame.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import Camera

TARGETS = 3
"""Targets of a sample."""

CANDIDATES = 200
"""Most views of a clip that are considered: of each stretch of frames the sharpest."""

DARK, BRIGHT = 0.08, 0.92
"""Mean grey, as a fraction of white, outside of which a photograph is badly exposed."""


@dataclass(frozen=True)
class Bounds:
    """What is asked of a pair.

    Attributes
    ----------
    min_overlap, max_overlap : float
        Fraction of each context view that the other sees, the smaller of the two, if all of it lies
        at the view's typical depth.
    min_baseline, max_baseline : float
        Distance between the two cameras as a fraction of that depth. Too far apart, and what
        overlaps in space may be hidden, or seen from another side.
    max_blur : float
        By how much a view may be more blurred than the median view of its clip, on the scale of
        :func:`slgaussian.datasets.sharpness.blur`.
    max_clipped : float
        Fraction of pixels that may be black or white.
    most : int
        Samples of a clip at most, 0 for as many as there are.
    """

    min_overlap: float = 0.6
    max_overlap: float = 1.0
    min_baseline: float = 0.08
    max_baseline: float = 0.4
    max_blur: float = 0.16
    max_clipped: float = 0.4
    most: int = 0


@dataclass(frozen=True, eq=False)
class Views:
    """What is known of the N views of a clip, in the order in which they were taken.

    Attributes
    ----------
    cameras : sequence of N Camera
    depths : float64 [N]
        Typical z-depth of each view, scene units; NaN where it is not known.
    blur, mean, clipped : float64 [N]
        See :mod:`slgaussian.datasets.sharpness`.
    """

    cameras: Sequence[Camera]
    depths: np.ndarray
    blur: np.ndarray
    mean: np.ndarray
    clipped: np.ndarray

    def usable(self, bounds: Bounds) -> np.ndarray:
        """Which views are sharp and well exposed, bool [N]."""
        sharp = self.blur <= np.median(self.blur) + bounds.max_blur
        exposed = (self.mean >= DARK) & (self.mean <= BRIGHT)
        return sharp & exposed & (self.clipped <= bounds.max_clipped)


@dataclass(frozen=True)
class Pair:
    """A sample: views by their place in the clip.

    Attributes
    ----------
    context : (int, int)
        In order.
    targets : tuple of int
        Strictly between them, in order.
    overlap, baseline : float
        As :class:`Bounds` has them.
    depth : float
        Mean of the typical depths of the context views, scene units.
    score : float
        What pairs were compared by, from 0, poor, to 1.
    """

    context: tuple[int, int]
    targets: tuple[int, ...]
    overlap: float
    baseline: float
    depth: float
    score: float


def choose(clip: Views, bounds: Bounds, targets: int = TARGETS) -> list[Pair]:
    """The samples of a clip that together score most, no two of which share a frame.

    A pair scores by how far its overlap is from the bounds and how sharp it is, from 0.25 to 1, so
    that more samples mostly beat better ones. Every view between must overlap one of the two by
    half of the least overlap: a camera may come back from elsewhere. The ``targets``, so many, are
    those nearest to equal parts of the way: three to its quarters. There is no chance in it: equal
    scores go to the earlier frames.

    Raises
    ------
    InputError
        If there is none; the message says what was found, for the caller to name the clip.
    """
    usable = np.flatnonzero(clip.usable(bounds))
    count = len(clip.cameras)
    if len(usable) < targets + 2:
        raise InputError(
            f"{len(usable)} of its {count} views are sharp and well exposed, too few for a sample "
            f"of 2 context views and {targets} targets between them"
        )
    if np.isnan(clip.depths).any():
        raise InputError(
            "its views show no parallax that a depth could be found from: too few matches agree "
            "with the poses, or the camera stood still"
        )
    frames = _sharpest_of_stretches(usable, clip.blur)
    centers = np.stack([clip.cameras[i].center for i in frames])
    depths = clip.depths[frames]
    far = np.linalg.norm(centers[:, None] - centers, axis=-1)
    baselines = far / ((depths[:, None] + depths) / 2)
    seen = overlaps([clip.cameras[i] for i in frames], depths)
    shared = np.minimum(seen, seen.T)
    fits = (shared >= bounds.min_overlap) & (shared <= bounds.max_overlap)
    fits &= (baselines >= bounds.min_baseline) & (baselines <= bounds.max_baseline)
    pairs = []
    for a, b in np.argwhere(np.triu(fits, 1)):
        between = np.maximum(shared[a, a + 1 : b], shared[b, a + 1 : b])
        if len(between) < targets or between.min() < bounds.min_overlap / 2:
            continue
        chosen = _parting(frames[a : b + 1], targets)
        context = int(frames[a]), int(frames[b])
        overlap = float(shared[a, b])
        value = score(overlap, clip.blur[list(context)], clip.blur, bounds)
        depth = float(depths[[a, b]].mean())
        pairs.append(Pair(context, chosen, overlap, float(baselines[a, b]), depth, value))
    if not pairs:
        apart = np.triu(np.ones_like(fits), 1)
        raise InputError(
            f"no two of its views have an overlap of {bounds.min_overlap:g} to "
            f"{bounds.max_overlap:g}, a baseline of {bounds.min_baseline:g} to "
            f"{bounds.max_baseline:g} depths and {targets} usable views between them; found "
            f"overlaps of {shared[apart].min():.2f} to {shared[apart].max():.2f} and baselines "
            f"of {baselines[apart].min():.2f} to {baselines[apart].max():.2f}"
        )
    best = beside_each_other(pairs)
    if bounds.most:
        best = sorted(sorted(best, key=lambda p: -p.score)[: bounds.most], key=lambda p: p.context)
    return best


def overlaps(cameras: Sequence[Camera], depths: np.ndarray) -> np.ndarray:
    """:func:`slgaussian.scene.shared_view` of every view in every other, float64 [N, N].

    Row a, column b: the fraction of a's image that lands inside b if it all lies at ``depths[a]``.
    """
    return np.stack([s.mean(-1) for s in sightings(cameras, depths)])


def sightings(cameras: Sequence[Camera], depths: np.ndarray) -> Iterator[np.ndarray]:
    """Yield for one view after the other where in it every view looks, bool [N, 81].

    Row b: which pixels of a regular grid over the image land inside b if all of it lies at its
    depth.
    """
    grid = (np.arange(9) + 0.5) / 9
    fractions = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    ends = np.array([(c.width, c.height) for c in cameras], np.float64)
    w2c = np.stack([c.w2c for c in cameras])
    K = np.stack([c.K for c in cameras])
    for camera, end, depth in zip(cameras, ends, depths, strict=True):
        pixels = np.concatenate([fractions * end, np.ones((len(fractions), 1))], 1)
        local = depth * pixels @ np.linalg.inv(camera.K).T
        world = local @ camera.c2w[:3, :3].T + camera.center
        there = world @ w2c[:, :3, :3].mT + w2c[:, None, :3, 3]
        image = there @ K.mT
        z = image[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = image[..., :2] / z
        yield (z[..., 0] > 0) & (xy >= 0).all(-1) & (xy < ends[:, None]).all(-1)


def beside_each_other(pairs: Sequence[Pair]) -> list[Pair]:
    """The pairs that together score most and of which no two share a frame, in order.

    Weighted interval scheduling (Kleinberg and Tardos, "Algorithm Design", section 6.1).
    """
    pairs = sorted(pairs, key=lambda pair: (pair.context[1], pair.context[0]))
    ends = [pair.context[1] for pair in pairs]
    best = [0.0]
    for index, pair in enumerate(pairs):
        before = bisect_left(ends, pair.context[0])
        best.append(max(best[index], best[before] + pair.score))
    chosen, index = [], len(pairs)
    while index:
        if best[index] > best[index - 1]:
            chosen.append(pairs[index - 1])
            index = bisect_left(ends, pairs[index - 1].context[0])
        else:
            index -= 1
    return chosen[::-1]


def _sharpest_of_stretches(usable: np.ndarray, blur: np.ndarray) -> np.ndarray:
    stretches = np.array_split(usable, min(CANDIDATES, len(usable)))
    return np.array([stretch[blur[stretch].argmin()] for stretch in stretches])


def _parting(frames: np.ndarray, count: int) -> tuple[int, ...]:
    """So many frames, of two more at least in ascending order, near equal parts of the way."""
    between = frames[1:-1]
    chosen: list[int] = []
    for mark in np.linspace(frames[0], frames[-1], count + 2)[1:-1]:
        nearest = np.abs(between - mark).argmin()
        chosen.append(int(between[nearest]))
        between = np.delete(between, nearest)
    return tuple(sorted(chosen))


def score(overlap: float, own: np.ndarray, blur: np.ndarray, bounds: Bounds) -> float:
    """How good a pair is, 0.25 to 1: half of it its overlap, most in the middle of the bounds, and
    half the blur of the worse view, ``own`` being that of its two and ``blur`` that of all."""
    middle = (bounds.min_overlap + bounds.max_overlap) / 2
    half = max((bounds.max_overlap - bounds.min_overlap) / 2, 1e-9)
    central = 1 - 0.5 * abs(overlap - middle) / half
    worst = float(own.max() - np.median(blur)) / max(bounds.max_blur, 1e-9)
    return central * (1 - 0.5 * float(np.clip(worst, 0, 1)))
