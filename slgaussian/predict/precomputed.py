"""The predictor ``precomputed``: depth maps from files, interpreted by matches of the photographs.

A file does not say whether depth is along z or along the ray, in which unit, and whether the map
was stretched, cropped or padded from its photograph. Under the right interpretation, the depth of a
keypoint reprojects it to its match in the other view.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from slgaussian.cameras.check import COARSE_DISTANCE, agree
from slgaussian.cameras.match_graph import match_views
from slgaussian.cameras.relative import Relative
from slgaussian.checks import companion
from slgaussian.errors import InputError
from slgaussian.formats.depth_maps import (
    DepthMap,
    known_depth,
    numbered_views,
    read_geometry,
    read_map,
)
from slgaussian.formats.resampling import Window, sample_depth
from slgaussian.gaussians import Gaussians
from slgaussian.masks.configs import DEPTH_SUFFIXES
from slgaussian.predict.configs import PrecomputedGeometryConfig
from slgaussian.predict.depth_completion import AGREES, BEHIND, IN_FRONT, UNSEEN, cross_check
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.depth_propagation import SweptView
from slgaussian.predict.planesweep import PlaneSweep, assemble, choose_steps, depth_range
from slgaussian.predict.view_graph import ViewGraph, link_views
from slgaussian.scene import Camera, Sample, View

MIN_EXPLAINED_SHARE = 0.5
"""Share of the matches whose reprojection error must be within
:data:`slgaussian.cameras.check.COARSE_DISTANCE`. Right readings reach 0.8 and more."""

MAX_ERROR_RATIO = 0.85
MIN_PARALLAX = 0.3
"""Matches confirm a reading whose reprojection error is below ``MAX_ERROR_RATIO`` times that of a
constant depth. One that they do not confirm is refused if the error of a constant depth is above
``MIN_PARALLAX``: with less parallax nearly any depth fits, and they can tell nothing."""

BETTER_ERROR_RATIO = 0.9
"""A less usual reading is chosen if its error is below this share of the error of the usual one."""

MIN_SCALE_PARALLAX = 1.0
"""Smallest parallax of a match, pixels, from which a scale is measured."""

UNIT_TOLERANCE = 0.03
"""Relative difference up to which a scale is rounded to a power of ten, as for millimetres."""

CONFIDENCE_LEVELS = 10
"""Number of quantiles into which confidence is divided."""

FRAME_NUMBERS = re.compile(r"_\d{4,}_\d{4,}$")
"""Frame numbers at the end of the name of a sample of a place, as in ``hall_0003_0007``."""

Matches = Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]]
"""Matching points float64 [M, 2] and [M, 2], pixels, of pairs of views."""

Depth = Callable[[np.ndarray], np.ndarray]
"""Takes pixels [M, 2] of a view to z-depths float64 [M], 0 where unknown."""


class PrecomputedGeometry(PrecomputedGeometryConfig):
    """Depth maps from files, in the cameras of the sample; Gaussians as those of ``planesweep``.

    ``geometry`` is an NPZ with a map of every context view (:mod:`slgaussian.formats.depth_maps`),
    assigned by its array ``names`` or, without one, by the order of the views; or a folder with a
    file for each view, of the same name: for ``images/0013.jpg`` it is ``images/0013.png``,
    or else ``0013.png``, or another of :data:`slgaussian.masks.configs.DEPTH_SUFFIXES`, and
    confidence ``0013_conf.png``; or the views of a folder, in their order, as
    :func:`slgaussian.formats.depth_maps.numbered_views` lists them. With several scenes, each may
    have a subfolder of its name; samples of one place, such as ``hall_0003_0007``, share the
    subfolder of the place, ``hall``.

    Pixels without depth are completed like pixels that a sweep could not match. Pixels of a level
    of confidence that other views mostly contradict are marked as guessed.

    Raises:
        InputError: If the file or folder does not exist. When called: if a map is missing or cannot
            be read, or no reading of the maps fits the photographs.
    """

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.geometry is None:
            raise InputError(
                "precomputed geometry: none given; give an NPZ or a folder of depth, as in --set "
                "precomputed.geometry=results.npz"
            )
        if not self.geometry.exists():
            raise InputError(f"precomputed geometry: there is no {str(self.geometry)!r}")

    def __call__(self, sample: Sample, seed: int = 0) -> Gaussians:
        """Predict Gaussians in the world frame of ``sample``; the result ignores ``seed``."""
        assert self.geometry is not None  # checked by __init__
        sample, frame = replace(sample, matches=match_views(sample)).localize()
        maps, matches = find_maps(self.geometry, sample), agreeing(sample)
        depths, confidences = _read(self.geometry, sample.context, maps, matches)
        linked = link_views(sample, ranged=True)
        swept, low = _cross_check_all(sample, linked, depths, confidences)
        gaussians = assemble(sample, linked, swept)
        arrays = gaussians.to_arrays()
        guessed = arrays["guessed"] | low.ravel()[arrays["source"]]
        return gaussians.with_arrays(guessed=guessed).place(frame)


def find_maps(place: Path, sample: Sample) -> list[DepthMap]:
    """Find and read the map of every context view; InputError as :class:`PrecomputedGeometry`."""
    if place.is_file() and place.suffix == ".npz":
        return _select_maps(place, sample.context)
    if not place.is_dir():
        raise InputError(f"{place}: is no folder and no .npz; give one of both")
    folders = (place / name for name in (sample.scene, FRAME_NUMBERS.sub("", sample.scene)))
    place = next((folder for folder in folders if folder.is_dir()), place)
    if numbered_views(place):
        return _select_maps(place, sample.context)
    return [_find_map(place, view) for view in sample.context]


def _select_maps(file: Path, views: Sequence[View]) -> list[DepthMap]:
    stored = read_geometry(file)
    others = [name for view in views for name in view.namesakes]
    numbers = stored.numbers([view.name for view in views], others)
    for view in views:
        if view.name not in numbers:
            names = ", ".join((stored.names or [])[:4])
            raise InputError(
                f"{file}: has no map of view {view.name!r}; its names begin with {names}"
            )
    return [stored.maps[numbers[view.name]] for view in views]


def _find_map(folder: Path, view: View) -> DepthMap:
    file = companion(folder, view.name, DEPTH_SUFFIXES, view.namesakes)
    if file is None:
        if (other := companion(folder, view.name, (".exr",), view.namesakes)) is not None:
            read_map(other)  # says what to save instead
        raise InputError(
            f"{folder}: has no depth of view {view.name!r}; expected {Path(view.name).stem} with "
            f"one of {', '.join(DEPTH_SUFFIXES)}"
        )
    if file.suffix == ".npz":
        return _select_maps(file, [view])[0]
    suffixes = [f"_conf{suffix}" for suffix in DEPTH_SUFFIXES]
    beside = companion(folder, view.name, suffixes, view.namesakes)
    confidence = None if beside is None else read_map(beside, byte=True)
    return DepthMap(str(file), known_depth(read_map(file)), confidence)


def agreeing(sample: Sample) -> Matches:
    """Return the matches of each pair that fit a fundamental matrix, independent of the cameras."""
    graph = match_views(sample)
    bound = COARSE_DISTANCE * float(np.hypot(*sample.context[0].grey.shape))
    matches_of_pair = {}
    for pair in graph.matches:
        a, b = graph.points(*pair)
        keep = agree(a, b, bound)
        if keep.sum() >= MIN_MATCHES:
            matches_of_pair[pair] = a[keep], b[keep]
    return matches_of_pair


def placements(width: int, height: int, photo: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return the ways in which a map of a size may cover a photograph of ``photo`` (width, height).

    Returns:
        dict str -> float64 [3, 3]: Transforms from pixels of the photograph to those of the map, by
            operation.
    """
    x, y = width / photo[0], height / photo[1]
    ways = {"stretched": np.diag([x, y, 1.0])}
    if not Window.whole(*photo).has_shape(width, height):
        for way, s in (("cropped", max(x, y)), ("padded", min(x, y))):
            left, top = (width - s * photo[0]) / 2, (height - s * photo[1]) / 2
            ways[way] = np.array([[s, 0, left], [0, s, top], [0, 0, 1.0]])
    return ways


def along_z(depth: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Convert distances along the ray [h, w], of intrinsics in pixels of the map, to z."""
    rows, columns = np.indices(depth.shape) + 0.5
    rays = np.stack([columns, rows, np.ones(depth.shape)], -1) @ np.linalg.inv(K).T
    return depth / np.linalg.norm(rays, axis=-1)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Reprojection error of the matches under one reading of the depth.

    Attributes:
        error: Mean reprojection error as a share of the bound, each clipped at 1.
        share: Share of the matches within the bound.
        blank: That share for one depth for all pixels, at the best scale.
        count: Number of matches with depth, in both directions.
        scales: float64 [V]. Factors of the depth of each view.
        scaling: Description of the scaling for people; empty without one.
    """

    error: float
    share: float
    count: int
    scales: np.ndarray
    scaling: str
    blank: float = 0.0

    @property
    def evidence(self) -> str:
        """Return a clause on what the matches say, for people."""
        return (
            f"{self.share:.0%} of {self.count} matches to where the other view shows them, and one "
            f"depth for all pixels {self.blank:.0%}"
        )


def z_at(depth: np.ndarray, at: np.ndarray) -> Depth:
    """Return a function that looks up z at pixels of a view; ``at`` [3, 3] maps them to the map."""

    def look_up(points: np.ndarray) -> np.ndarray:
        column, row = np.floor(points @ at[:2, :2].T + at[:2, 2]).astype(np.int64).T
        inside = (row >= 0) & (row < depth.shape[0]) & (column >= 0) & (column < depth.shape[1])
        return np.where(inside, depth[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)

    return look_up


def fit(cameras: Sequence[Camera], depths: Sequence[Depth], matches: Matches) -> Fitted:
    """Reproject matches by the z-depth of V views, with one scale or one a view if better."""
    bound = COARSE_DISTANCE * float(np.hypot(cameras[0].height, cameras[0].width))
    measurements = []
    for (i, j), (p, q) in matches.items():
        for a, b, points, matched in ((i, j, p, q), (j, i, q, p)):
            z = depths[a](points)
            in_front = z > 0
            relative = Relative.between(cameras[a], cameras[b])
            measurements.append((a, relative, points[in_front], matched[in_front], z[in_front]))
    ones = np.ones(len(cameras))
    ratios: list[list[np.ndarray]] = [[] for _ in cameras]
    for a, relative, points, matched, z in measurements:
        inverse = relative.triangulate(points, matched)
        moves = inverse * relative.parallax(points) > MIN_SCALE_PARALLAX
        ratios[a].append(1 / (inverse[moves] * z[moves]))
    per_view = [np.concatenate([np.zeros(0), *of_view]) for of_view in ratios]
    all_ratios = np.concatenate(per_view)
    tries = [("", ones)]
    if len(all_ratios) >= MIN_MATCHES:
        common = float(np.median(all_ratios))
        unit = float(10.0 ** np.round(np.log10(common)))
        if abs(common / unit - 1) < UNIT_TOLERANCE:
            common = unit
        tries.append((f"times {common:.4g}", ones * common))
        of_view = np.array([np.median(r) if len(r) >= MIN_MATCHES else common for r in per_view])
        tries.append((f"times {of_view.min():.4g} to {of_view.max():.4g}, by view", of_view))
    best = Fitted(1.0, 0.0, 0, ones, "")
    for scaling, scales in tries:
        off = [np.zeros(0)]
        for a, relative, points, matched, z in measurements:
            at, ratio = relative.project(points, 1 / (scales[a] * z))
            off.append(np.where(ratio > 0, np.linalg.norm(at - matched, axis=-1), np.inf) / bound)
        errors = np.concatenate(off)
        if len(errors):
            error, share = float(np.minimum(errors, 1).mean()), float((errors < 1).mean())
            if not best.count or error < BETTER_ERROR_RATIO * best.error:
                best = Fitted(error, share, len(errors), scales, scaling)
    return best


Reading = tuple[Any, Sequence[Camera], Sequence[Depth]]
"""A way to read a file: its label, and the cameras and depth of V views that result."""


def choose_reading(
    place: Path, readings: Sequence[Reading], matches: Matches
) -> tuple[Reading, Fitted]:
    """Choose the first reading that no other one fits much better.

    It is said if the matches are too few to check it, or a constant depth fits them as well.

    Raises:
        InputError: If that one does not fit the photographs, or, if they can tell, not much better
            than a constant depth; or if the inverse of the maps does.
    """
    tried = [(reading, fit(*reading[1:], matches)) for reading in readings]
    best_error = min(fitted.error for _, fitted in tried)
    chosen, fitted = next(one for one in tried if BETTER_ERROR_RATIO * one[1].error <= best_error)
    blank = fit(chosen[1], [_raise_depth(depth, 0) for depth in chosen[2]], matches)
    fitted = replace(fitted, blank=blank.share)
    if fitted.count < 2 * MIN_MATCHES:
        warnings.warn(
            f"{place}: too few matches, {fitted.count}, to check how its numbers are meant; read "
            "in the usual way, depth along z as it is",
            stacklevel=5,
        )
        return chosen, fitted
    is_confirmed = fitted.error <= MAX_ERROR_RATIO * blank.error
    advice = ""
    if not is_confirmed:
        inverse = min(
            (fit(cameras, [_raise_depth(depth, -1) for depth in depths], matches)
             for _, cameras, depths in readings),
            key=lambda one: one.error,
        )  # fmt: skip
        if inverse.error < MAX_ERROR_RATIO * min(blank.error, fitted.error):
            advice = f"; 1 / map takes {inverse.share:.0%}, so it is disparity or inverse depth: "
            advice += "give depth"
    misfit = blank.error > MIN_PARALLAX and not is_confirmed
    if fitted.share < MIN_EXPLAINED_SHARE or misfit or advice:
        raise InputError(
            f"{place}: depth does not fit the photographs: the best of {len(tried)} readings, "
            f"along z or the ray, takes {fitted.evidence}"
            + (advice or "; check that each map is of its photograph, in their order, and of these "
               "cameras")
        )  # fmt: skip
    if not is_confirmed:
        warnings.warn(
            f"{place}: the matches cannot confirm the depth: it takes {fitted.evidence}; "
            "photographs from places farther apart could",
            stacklevel=5,
        )
    return chosen, fitted


def _raise_depth(depth: Depth, power: int) -> Depth:
    """Return a function that looks up a power of the depth, 0 where it is unknown."""

    def look_up(points: np.ndarray) -> np.ndarray:
        z = np.asarray(depth(points), np.float64)
        return np.power(z, power, out=np.zeros(z.shape), where=z > 0)

    return look_up


def _read(
    place: Path, views: Sequence[View], maps: Sequence[DepthMap], matches: Matches
) -> tuple[list[np.ndarray], list[np.ndarray | None]]:
    """Return z-depth V of [H, W] in scene units, 0 where unknown, and confidence or None."""
    if not any((depth_map.depth > 0).any() for depth_map in maps):
        raise InputError(f"{place}: its maps hold no depth; expected positive numbers")
    cameras = [view.camera for view in views]
    ways = [_view_to_map(view, depth_map) for view, depth_map in zip(views, maps, strict=True)]
    readings: list[Reading] = []
    for way, ray in product(ways[0], (False, True)):
        at = [of_view.get(way, next(iter(of_view.values()))) for of_view in ways]
        zs = [
            along_z(depth_map.depth, to_map @ camera.K) if ray else depth_map.depth
            for depth_map, to_map, camera in zip(maps, at, cameras, strict=True)
        ]
        readings.append(((way, ray, at, zs), cameras, list(map(z_at, zs, at))))
    ((way, ray, at, zs), _, _), fitted = choose_reading(place, readings, matches)
    applies = ray, len(ways[0]) > 1, bool(fitted.scaling)
    possible = "along the ray", f"of {way} photographs", fitted.scaling
    if notes := [note for note, holds in zip(possible, applies, strict=True) if holds]:
        warnings.warn(
            f"{place}: depth is read {', '.join(notes)}: so it takes {fitted.evidence}",
            stacklevel=4,
        )
    views_depth, confidence = [], []
    for depth_map, z, to_map, camera, scale in zip(
        maps, zs, at, cameras, fitted.scales, strict=True
    ):
        same = z.shape == (camera.height, camera.width) and np.allclose(
            to_map, np.eye(3), atol=1e-9
        )
        x = to_map[0, 0] * (np.arange(camera.width) + 0.5) + to_map[0, 2]
        y = to_map[1, 1] * (np.arange(camera.height) + 0.5) + to_map[1, 2]
        z = z if same else sample_depth(z.astype(np.float32), x[None], y[:, None])
        views_depth.append(scale * z)
        row, column = (
            axis.astype(np.int64).clip(0, size - 1)
            for axis, size in zip((y, x), depth_map.depth.shape, strict=True)
        )
        confidence.append(
            None if depth_map.confidence is None else depth_map.confidence[np.ix_(row, column)]
        )
    return views_depth, confidence


def _view_to_map(view: View, depth_map: DepthMap) -> dict[str, np.ndarray]:
    """From pixels of the view to those of its map; first what the file's intrinsics fit best."""
    part, camera = view.visible_window, view.camera
    x, y = (part.right - part.left) / camera.width, (part.bottom - part.top) / camera.height
    to_photo = np.array([[x, 0, part.left], [0, y, part.top], [0, 0, 1.0]])
    height, width = depth_map.depth.shape
    ways = placements(width, height, (part.photo_width, part.photo_height))
    ways = {way: at @ to_photo for way, at in ways.items()}
    K = depth_map.K
    if K is not None:
        ways = dict(sorted(ways.items(), key=lambda way: np.abs(way[1] @ camera.K - K).sum()))
    return ways


def _cross_check_all(
    sample: Sample,
    linked: ViewGraph,
    depths: Sequence[np.ndarray],
    confidences: Sequence[np.ndarray | None],
) -> tuple[list[SweptView], np.ndarray]:
    """Cross-check all depths, as after a sweep; also return a mask of low confidence [V, H, W]."""
    links, settings = linked.links, PlaneSweep()
    has_depth = np.array([depth > 0 for depth in depths])
    inverse = [
        np.divide(1, z, out=np.ones(z.shape), where=z > 0).astype(np.float32) for z in depths
    ]
    all_sparse = np.concatenate([link.sparse for of_view in links for link in of_view])
    steps = []
    for i, view in enumerate(sample.context):
        ends = np.percentile(inverse[i][has_depth[i]], (0.1, 99.9)) if has_depth[i].any() else []
        try:
            low, high = depth_range(sample.scene, view, links[i], all_sparse)
        except InputError:  # too few matches
            if not len(ends):
                raise
            low, high = 0.5 * ends[0], 1.25 * ends[1]
        low, high = min([low, *ends]), max([high, *ends])
        steps.append(choose_steps(settings, links[i], view.grey.shape, low, high)[1])
        inverse[i] = np.where(has_depth[i], inverse[i], np.float32(steps[i].mean()))
    agrees, judged = np.zeros_like(has_depth), np.zeros_like(has_depth)
    for i, of_view in enumerate(links):
        for link in of_view:
            step = steps[i][1] - steps[i][0]
            has_source, source_inverse = has_depth[link.source], inverse[link.source]
            far, near = (
                cross_check(
                    inverse[i], np.where(has_source, source_inverse, blank), link.relative, step
                )
                for blank in (np.float32(np.inf), np.float32(0))
            )
            # Where the other view has no depth, the pixel may still agree.
            open_ = (far == BEHIND) & (near == IN_FRONT)
            judged[i] |= has_depth[i] & (far != UNSEEN) & ~open_
            agrees[i] |= has_depth[i] & ((far == AGREES) | open_)
    low_confidence = _low_confidence(confidences, agrees, judged)
    views = zip(steps, inverse, agrees & ~low_confidence, has_depth, strict=True)
    return [SweptView(*view) for view in views], low_confidence


def _low_confidence(
    confidences: Sequence[np.ndarray | None], agrees: np.ndarray, judged: np.ndarray
) -> np.ndarray:
    """Mask the lowest levels of confidence, of which other views contradict more than half."""
    low = np.zeros_like(agrees)
    if any(confidence_map is None for confidence_map in confidences) or not judged.any():
        return low
    confidence = np.stack(
        [confidence_map for confidence_map in confidences if confidence_map is not None]
    )
    levels = np.unique(
        np.quantile(
            confidence[judged], np.arange(CONFIDENCE_LEVELS) / CONFIDENCE_LEVELS, method="nearest"
        )
    )
    level = np.searchsorted(levels, confidence, side="right")
    for k in range(1, len(levels) + 1):
        at = judged & (level == k)
        if agrees[at].mean() >= MIN_EXPLAINED_SHARE:
            break
        low |= level <= k
    return low
