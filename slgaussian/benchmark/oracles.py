"""Truth in the place of a stage: what would have come out, had that stage made no mistake.

Each function stands for one stage of the way from photographs to an answer;
:mod:`slgaussian.benchmark.attribution` puts them in order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.language.bank import MemoryBank
from slgaussian.language.objectmap import ObjectMap
from slgaussian.masks.flatten import nearest_pixel
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera, Sample, View
from slgaussian.semantic.decode import elected_ids

CRUMB = 0.05
"""Fraction of a mask below which a connected part of it does not count."""

BEHIND = 0.05
"""Fraction of its depth by which a point must lie behind what a view shows, to be hidden there."""

SPECK = 7
"""Side of the window, pixels, in which one pixel with a known place is enough to fill the gaps of
truth that is carried back."""

OPAQUE = 0.5
"""Least opacity of a Gaussian that lies where it is known to belong: a predictor makes those faint
whose depth it doubts. With 0.9 the IoU in made-up rooms is 0.016 lower."""


def best_prefix(keys: np.ndarray, inside: np.ndarray, areas: np.ndarray, total: int) -> np.ndarray:
    """Choose pieces, in falling order of a key, so that their union overlaps best.

    With scores for keys it is the best that any threshold can do. With ``inside / areas`` it is the
    best that any choice of pieces can do: at the best IoU t, taking a piece pays if and only if its
    pixels inside are more than t times those outside, and that goes by the fraction inside.

    Parameters
    ----------
    keys : float [N]
        Equal ones are taken together.
    inside, areas : int [N]
        Pixels of each piece in the mask, and all of them. Pieces do not overlap; those without a
        pixel are never taken.
    total : int
        Pixels of the mask.

    Returns
    -------
    bool [N]
        The fewest pieces among equally good prefixes; none if no piece touches the mask.
    """
    chosen = np.zeros(len(keys), bool)
    seen = np.flatnonzero(areas > 0)
    order = seen[np.argsort(-keys[seen], kind="stable")]
    hits, sizes = np.cumsum(inside[order]), np.cumsum(areas[order])
    ious = hits / np.maximum(total + sizes - hits, 1)
    ious[:-1][keys[order][1:] == keys[order][:-1]] = 0
    if ious.max(initial=0) > 0:
        chosen[order[: int(ious.argmax()) + 1]] = True
    return chosen


def best_pieces(seen: ObjectMap, truth: np.ndarray) -> np.ndarray:
    """Choose the objects of an image that, united, overlap a mask bool [H, W] best: bool [N]."""
    inside = seen.areas_within(truth)
    fractions = inside / np.maximum(seen.areas, 1)
    return best_prefix(fractions, inside, seen.areas, int(np.count_nonzero(truth)))


def best_wholes(seen: ObjectMap, bank: MemoryBank, truth: np.ndarray) -> np.ndarray:
    """Choose objects if only whole things may be named, one a part of the truth.

    A whole thing is what words are compared with: an object, or a group of the bank. There may be
    as many as the truth bool [H, W] has :func:`parts`; the one that helps the IoU most goes first.
    Returns bool [N].
    """
    inside, total = seen.areas_within(truth), np.count_nonzero(truth)
    members = np.eye(len(bank), dtype=bool)
    if bank.levels is not None and bank.group_features is not None:
        groups = np.arange(len(bank), len(bank) + len(bank.group_features))
        members = np.concatenate([members, (bank.levels == groups[:, None, None]).any(1)])
    chosen, best = np.zeros(len(bank), bool), 0.0
    for _ in range(parts(truth)):
        tried = members | chosen
        ious = tried @ inside / (total + tried @ (seen.areas - inside))
        if ious.max(initial=0) <= best:
            break
        best, chosen = ious.max(), tried[ious.argmax()]
    return chosen


def parts(mask: np.ndarray) -> int:
    """Count connected parts of a mask bool [H, W] that are no crumbs of it: :data:`CRUMB`."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    areas = stats[1:, cv2.CC_STAT_AREA]
    return int(np.count_nonzero(areas >= CRUMB * areas.sum()))


def elect(gaussians: Gaussians, labels: np.ndarray, camera: Camera) -> np.ndarray:
    """Draw labels int32 [N] of Gaussians, 0 nothing: int32 [H, W], 0 where nothing is visible."""
    nothing = torch.zeros((len(gaussians), 0))
    image = rasterize(gaussians, nothing, camera, labels=torch.from_numpy(labels))
    every = np.arange(1, int(labels.max(initial=0)) + 1, dtype=np.int32)
    assert image.label is not None and image.label_weights is not None  # asked for
    return elected_ids(image.label.numpy(), image.label_weights.numpy(), every)[0]


def each_view(gaussians: Gaussians, count: int, size: int) -> list[Gaussians]:
    """Return the Gaussians of each of ``count`` views of ``size`` pixels, ``source`` within it."""
    view = gaussians.source // size
    bare = replace(gaussians, features=None)
    own = [bare[torch.nonzero(view == index)[:, 0]] for index in range(count)]
    return [replace(part, source=part.source - index * size) for index, part in enumerate(own)]


def own_pieces(
    gaussians: Gaussians, views: Sequence[Gaussians], pieces: np.ndarray, camera: Camera
) -> list[np.ndarray]:
    """Draw each view's own pieces [V, H, W], those of :func:`each_view` alone; then all together.

    Pieces are as they were before association, 0 none; in the last image no piece of one view is
    that of another.
    """
    drawn = [
        elect(alone, own.ravel()[alone.source.numpy()].astype(np.int32), camera)
        for own, alone in zip(pieces, views, strict=True)
    ]
    starts = np.cumsum([0, *(int(own.max()) for own in pieces[:-1])])[:, None, None]
    every = np.where(pieces > 0, pieces + starts, 0).astype(np.int32)
    return [*drawn, elect(gaussians, every.ravel()[gaussians.source.numpy()], camera)]


@dataclass(frozen=True, eq=False)
class ContextTruth:
    """What the queries of a target frame mean in the context views.

    Attributes
    ----------
    labels : int32 [V, H, W]
        From 1, which is nothing that was asked for; a label is one set of queries.
    members : bool [L + 1, Q]
        Which queries a label belongs to.
    known : float64 [Q]
        Fraction of the pixels of a query that does not rest on predicted depth.
    """

    labels: np.ndarray
    members: np.ndarray
    known: np.ndarray


def context_truth(
    sample: Sample, target: View, masks: Mapping[str, np.ndarray], predicted: np.ndarray
) -> ContextTruth:
    """Return the truth of the context views for the masks bool [H, W] of a target, by query.

    It is exact where the data say what every pixel shows. Elsewhere the masks are carried back:
    each context pixel goes to the target by its true depth, or by ``predicted`` float [V, H, W]
    where that is not known, and takes what is labelled there, unless something hides it.
    """
    ids = {q: [i for i, phrase in sample.phrases.items() if phrase == q] for q in masks}
    exact = [view.instances for view in sample.context if view.instances is not None]
    if len(exact) == len(sample.context) and all(ids.values()):
        table = np.zeros((max(map(max, ids.values())) + 2, len(masks)), bool)
        for column, own in enumerate(ids.values()):
            table[np.array(own) + 1, column] = True
        labels = np.stack(exact)
        labels = np.where(labels + 1 < len(table), labels, 0).astype(np.int32) + 1
        return ContextTruth(labels, table, np.ones(len(masks)))
    sets, members = _sets(list(masks.values()))
    true = true_depths(sample)
    place = carried_back(sample, target, np.where(true > 0, true, predicted))
    place = np.stack([_without_specks(view) for view in place])
    labels = np.where(place >= 0, sets.ravel()[place], 1).astype(np.int32)
    counts = np.bincount(labels.ravel(), minlength=len(members))
    certain = np.bincount(labels[true > 0], minlength=len(members))
    known = certain @ members / np.maximum(counts @ members, 1)
    return ContextTruth(labels, members, known)


def true_depths(sample: Sample) -> np.ndarray:
    """Return true z-depth of the context views, float32 [V, H, W], 0 where it is not known."""
    nothing = np.zeros(sample.context[0].image.shape[:2], np.float32)
    return np.stack([nothing if v.depth is None else v.depth for v in sample.context])


def carried_back(sample: Sample, target: View, depths: np.ndarray) -> np.ndarray:
    """Return the pixel of the target that shows what a context pixel shows: its flat index, or -1.

    Parameters
    ----------
    depths : float [V, H, W]
        z-depth of the context views, 0 unknown. What hides what at the target is told by its true
        depth or, where that is not known, by these.

    Returns
    -------
    int64 [V, H, W]
    """
    height, width = target.image.shape[:2]
    nearest = np.full(height * width, np.inf)
    landed = []
    for view, depth in zip(sample.context, depths, strict=True):
        pixels, z = target.camera.project(view.camera.unproject(depth))
        inside = (depth > 0) & (z > 0) & (pixels >= 0).all(-1)
        inside &= (pixels < (width, height)).all(-1)
        column, row = np.where(inside[..., None], pixels, 0).astype(np.int64).transpose(2, 0, 1)
        place = np.where(inside, row * width + column, -1)
        np.minimum.at(nearest, place[inside], z[inside])
        landed.append((place, z))
    # Where the target is nearer a surface than the photographs, or larger than they are, its pixels
    # have gaps between them.
    side = 1 + 2 * max(1, math.ceil(height / sample.context[0].image.shape[0]))
    front = cv2.erode(
        nearest.reshape(height, width),
        np.ones((side, side), np.uint8),
        borderType=cv2.BORDER_REPLICATE,
    )
    if target.depth is not None:
        front = np.where(target.depth > 0, target.depth, front)
    limit = (1 + BEHIND) * front.ravel()
    return np.stack([np.where(z <= limit[place], place, -1) for place, z in landed])


def moved(gaussians: Gaussians, sample: Sample, predicted: np.ndarray) -> Gaussians:
    """Move Gaussians along their lines of sight to the true depth of their source pixels.

    They grow with their distance, and of each pixel the first, which shows it, does not stay faint.
    Those of pixels whose true or ``predicted`` depth [V, H, W] is not known stay as they are.
    """
    true = true_depths(sample).ravel()
    known = (true > 0) & (predicted.ravel() > 0)
    ratio = np.where(known, true / np.where(known, predicted.ravel(), 1), 1)
    source = gaussians.source.numpy()
    centers = np.stack([view.camera.center for view in sample.context])
    center = torch.from_numpy(centers[source // sample.context[0].image[..., 0].size])
    step = torch.from_numpy(ratio[source].astype(np.float64))[:, None]
    order = np.arange(len(source))
    first = np.empty(len(true), np.int64)
    first[source[::-1]] = order[::-1]
    certain = torch.from_numpy(known[source] & (first[source] == order))
    return replace(
        gaussians,
        means=(center + (gaussians.means.double() - center) * step).float(),
        scales=(gaussians.scales * step).float(),
        opacities=torch.where(certain, gaussians.opacities.clamp(min=OPAQUE), gaussians.opacities),
    )


def _without_specks(place: np.ndarray) -> np.ndarray:
    """Fill -1 in pixels of the target [H, W] from nearby: depth a little off hides some."""
    known = place >= 0
    if not known.any():
        return place
    nearest = place[nearest_pixel(known)]
    near = cv2.dilate(known.astype(np.uint8), np.ones((SPECK, SPECK), np.uint8)) > 0
    return np.where(near, nearest, -1)


def _sets(masks: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Number the sets of masks that pixels lie in: int32 [H, W] from 2, and bool [L + 1, Q]."""
    numbers = np.zeros(masks[0].shape, np.int64)
    for mask in masks:
        numbers = 2 * numbers + mask
        used = np.flatnonzero(np.bincount(numbers.ravel()))
        numbers = np.searchsorted(used, numbers)
    numbers += 2
    members = np.zeros((int(numbers.max()) + 1, len(masks)), bool)
    for column, mask in enumerate(masks):
        members[np.unique(numbers[mask]), column] = True
    return numbers.astype(np.int32), members
