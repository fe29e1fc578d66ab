"""Choose the views of samples: two context views and the targets on which they are evaluated.

Two context views should overlap enough to be matched and have enough parallax for depth; neither
they nor the targets may be blurred or badly exposed. The choice is deterministic: ties go to the
earlier views.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slgaussian.datasets.configs import Bounds, PairBounds, Rule
from slgaussian.errors import InputError
from slgaussian.scene import Camera

TARGETS = 3
"""Number of targets of a sample."""

MAX_CANDIDATES = 200
"""Largest number of views of a clip that are considered: the sharpest of each range of frames."""

MIN_MEAN_GREY, MAX_MEAN_GREY = 0.08, 0.92
"""Range of the mean grey, as a fraction of white, of a well exposed photograph."""


@dataclass(frozen=True, eq=False)
class Views:
    """Measures of the N views of a clip.

    Attributes:
        cameras: sequence of N Camera
        depths: float64 [N]. Typical z-depth of each view, scene units; NaN where unknown.
        blur, mean, clipped: float64 [N]. See :mod:`slgaussian.datasets.sharpness`.
    """

    cameras: Sequence[Camera]
    depths: np.ndarray
    blur: np.ndarray
    mean: np.ndarray
    clipped: np.ndarray

    def usable(self, bounds: PairBounds) -> np.ndarray:
        """Find the views that are sharp and well exposed, bool [N]."""
        sharp = self.blur <= np.median(self.blur) + bounds.max_blur
        exposed = (self.mean >= MIN_MEAN_GREY) & (self.mean <= MAX_MEAN_GREY)
        return sharp & exposed & (self.clipped <= bounds.max_clipped)


@dataclass(frozen=True)
class Pair:
    """A sample: views by their index in the clip.

    Attributes:
        context: (int, int). Ascending.
        targets: tuple of int. Ascending.
        overlap, baseline: As in :class:`slgaussian.datasets.configs.PairBounds`.
        depth: Mean of the typical depths of the context views, scene units.
        score: Quality of the pair, from 0, poor, to 1.
        cover, aside: As in :class:`slgaussian.datasets.configs.Rule`, if chosen by it.
    """

    context: tuple[int, int]
    targets: tuple[int, ...]
    overlap: float
    baseline: float
    depth: float
    score: float
    cover: float = math.nan
    aside: float = math.nan


def choose(clip: Views, bounds: Bounds, targets: int = TARGETS) -> list[Pair]:
    """Choose the samples of a film with the largest total score, of which no two share a frame.

    The score of a pair, from 0.25 to 1, depends on the distance of its overlap from the bounds and
    on its sharpness; more samples usually outweigh better ones. Targets lie between the two. Every
    view between them must overlap one of the two by half of the smallest overlap, because the
    camera may leave and return. Targets are nearest to equal steps along the path: three to its
    quarters.

    Raises:
        InputError: If there is none; the message states the reason, and the caller adds the name of
            the clip.
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
            "its views have no parallax to compute a depth from: too few matches agree "
            "with the poses, or the camera stood still"
        )
    stretches = np.array_split(usable, min(MAX_CANDIDATES, len(usable)))
    frames = np.array([stretch[clip.blur[stretch].argmin()] for stretch in stretches])
    overlap_matrix = overlaps([clip.cameras[i] for i in frames], clip.depths[frames])
    shared, baselines, fits = _compare(clip, frames, overlap_matrix, bounds)
    pairs = []
    for a, b in np.argwhere(np.triu(fits, 1)):
        between = np.maximum(shared[a, a + 1 : b], shared[b, a + 1 : b])
        if len(between) < targets or between.min() < bounds.min_overlap / 2:
            continue
        pair = _pair(clip, frames[[a, b]], shared[a, b], baselines[a, b], bounds)
        pairs.append(replace(pair, targets=_even_frames(frames[a : b + 1], targets)))
    if not pairs:
        upper = np.triu_indices_from(fits, 1)
        raise InputError(
            f"no two of its views have {targets} usable views between them, an overlap of "
            f"{bounds.min_overlap:g} to {bounds.max_overlap:g} and a baseline of "
            f"{bounds.min_baseline:g} to {bounds.max_baseline:g} depths; found overlaps up to "
            f"{shared[upper].max():.2f} and baselines up to {baselines[upper].max():.2f}"
        )
    best = schedule(pairs)
    if bounds.most:
        best = sorted(sorted(best, key=lambda p: -p.score)[: bounds.most], key=lambda p: p.context)
    return best


def surround(
    clip: Views, targets: Sequence[int], barred: Collection[int], rule: Rule
) -> list[Pair | str]:
    """Choose the best two context views of each target; none may be barred or a target.

    The best pair within the rule maximises its score (overlap near the middle of its bounds, sharp
    views) times the cover, reduced by up to a half for a target off the midpoint. Views may have
    any order. If there is no pair, the entry of the target is the reason.
    """
    is_usable = clip.usable(rule)
    is_usable[[*targets, *barred]] = False
    usable = np.flatnonzero(is_usable)
    count = len(usable)
    if count < 2:
        total = len(clip.cameras)
        return [f"{count} of {total} views are sharp, well exposed and not held out"] * len(targets)
    if np.isnan(clip.depths).any():
        return ["the views show no parallax that a depth could be found from"] * len(targets)
    visible = [*usable, *targets]
    sights = list(_sightings([clip.cameras[i] for i in visible], clip.depths[visible]))
    overlap_matrix = np.stack([sight[:count].mean(-1) for sight in sights[:count]])
    shared, baselines, fits = _compare(clip, usable, overlap_matrix, rule)
    a, b = np.nonzero(np.triu(fits & (baselines > 0), 1))
    pairs = [
        _pair(clip, usable[[i, j]], shared[i, j], baselines[i, j], rule)
        for i, j in zip(a, b, strict=True)
    ]
    scores = np.array([pair.score for pair in pairs])
    centers = np.stack([camera.center for camera in clip.cameras])
    first, second = centers[usable[a]], centers[usable[b]]
    separations = np.linalg.norm(first - second, axis=1)
    chosen: list[Pair | str] = []
    for target, sight in zip(targets, sights[count:], strict=True):
        aside = np.linalg.norm((first + second) / 2 - centers[target], axis=1) / separations
        cover = (sight[a] | sight[b]).mean(1)
        between = aside <= rule.max_aside
        good = between & (cover >= rule.min_cover)
        if not good.any():
            chosen.append(
                f"{len(pairs)} pairs of views fit by overlap and baseline and are not held out; "
                f"{between.sum()} of them have it between them, none sees {rule.min_cover:g} of it"
            )
            continue
        values = scores * cover * (1 - 0.5 * aside / max(rule.max_aside, 1e-9))
        k = int(np.where(good, values, -1).argmax())
        score, covered, separation = (float(measure[k]) for measure in (values, cover, aside))
        pair = replace(pairs[k], targets=(target,), score=score, cover=covered, aside=separation)
        chosen.append(pair)
    return chosen


def overlaps(cameras: Sequence[Camera], depths: np.ndarray) -> np.ndarray:
    """Compute how much of N views every other shows, float64 [N, N].

    Row a, column b: the fraction of image a that projects into b if all lies at ``depths[a]``.
    """
    return np.stack([sight.mean(-1) for sight in _sightings(cameras, depths)])


def _sightings(cameras: Sequence[Camera], depths: np.ndarray) -> Iterator[np.ndarray]:
    """Yield for each view which pixels of a grid, at its depth, each view shows: bool [N, 81]."""
    grid = (np.arange(9) + 0.5) / 9
    fractions = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    ends = np.array([(c.width, c.height) for c in cameras], np.float64)
    w2c = np.stack([c.w2c for c in cameras])
    K = np.stack([c.K for c in cameras])
    for camera, end, depth in zip(cameras, ends, depths, strict=True):
        pixels = np.column_stack([fractions * end, np.ones(len(fractions))])
        local = depth * pixels @ np.linalg.inv(camera.K).T
        world = local @ camera.c2w[:3, :3].T + camera.center
        image = (world @ w2c[:, :3, :3].mT + w2c[:, None, :3, 3]) @ K.mT
        z = image[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = image[..., :2] / z
        yield (z[..., 0] > 0) & (xy >= 0).all(-1) & (xy < ends[:, None]).all(-1)


def schedule(pairs: Sequence[Pair]) -> list[Pair]:
    """Choose the pairs with the largest total score, of which no two share a frame, in order.

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


def _compare(
    clip: Views, frames: np.ndarray, overlap_matrix: np.ndarray, bounds: PairBounds
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return overlap, baseline and whether both are within the bounds for all pairs, [N, N]."""
    centers = np.stack([clip.cameras[i].center for i in frames])
    depths = clip.depths[frames]
    separations = np.linalg.norm(centers[:, None] - centers, axis=-1)
    baselines = separations / ((depths[:, None] + depths) / 2)
    shared = np.minimum(overlap_matrix, overlap_matrix.T)
    fits = (shared >= bounds.min_overlap) & (shared <= bounds.max_overlap)
    fits &= (baselines >= bounds.min_baseline) & (baselines <= bounds.max_baseline)
    return shared, baselines, fits


def _pair(
    clip: Views, context: np.ndarray, overlap: float, baseline: float, bounds: PairBounds
) -> Pair:
    """Return a pair without targets.

    Its score is halved by an overlap at the bounds, and by a blur of the worse view at its bound.
    """
    middle = (bounds.min_overlap + bounds.max_overlap) / 2
    half = max((bounds.max_overlap - bounds.min_overlap) / 2, 1e-9)
    central = 1 - 0.5 * abs(float(overlap) - middle) / half
    worst = float(clip.blur[context].max() - np.median(clip.blur)) / max(bounds.max_blur, 1e-9)
    score = central * (1 - 0.5 * float(np.clip(worst, 0, 1)))
    depth = float(clip.depths[context].mean())
    first, second = context.tolist()
    return Pair((first, second), (), float(overlap), float(baseline), depth, score)


def _even_frames(frames: np.ndarray, count: int) -> tuple[int, ...]:
    """Return ``count`` frames near equal steps between the first and the last of ``frames``."""
    between = frames[1:-1]
    chosen: list[int] = []
    for mark in np.linspace(frames[0], frames[-1], count + 2)[1:-1]:
        nearest = np.abs(between - mark).argmin()
        chosen.append(int(between[nearest]))
        between = np.delete(between, nearest)
    return tuple(sorted(chosen))
