"""Inventory of a field's objects: best words, size, position and confidence of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.geometry.room import find_room
from slgaussian.io import short_repr
from slgaussian.language import COMMON_OBJECTS
from slgaussian.language.answer import ask
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules

if TYPE_CHECKING:
    from slgaussian.field import SemanticField
    from slgaussian.language.scoring import BankReader

MAX_DESCRIBING_WORDS = 3
"""Number of words that describe an object."""

NO_FIT = 0.5
"""Relevancy up to which a text fits no better than the canonical phrases."""

RENDERED_SIDE = 320
"""Longest side, in pixels, of the views that are rendered for confidence and the room."""

TRIMMED_PERCENT = 3.0
"""Percentage of points beyond each end of an axis of the box."""

MAX_RELATIVE_DISTANCE = 3.0
"""Distance from the median point, in units of the median distance, beyond which points are dropped:
a straight object ends at twice that."""

TESTED_ORIENTATIONS = 90
"""Number of tested orientations over a quarter turn."""

MAX_POINTS = 2000
"""Largest number of points, taken evenly."""


@dataclass(frozen=True, eq=False)
class Box:
    """A box in the world.

    Attributes:
        centre: float64 [3]. Scene units.
        axes: float64 [3, 3]. Unit vectors in rows, right-handed: along the longer side, along the
            shorter one, up.
        half_sizes: float64 [3]. Distances from the centre to the faces along the axes, scene units.
    """

    centre: np.ndarray
    axes: np.ndarray
    half_sizes: np.ndarray

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a field.

    Attributes:
        name: Name given by the user.
        words: tuple of (str, float). The texts that fit it best, with relevancies, best first; up
            to 0.5 a text fits no better than the canonical phrases.
        confidence: Mean confidence (:class:`slgaussian.field_view.FieldView`) of its pixels in the
            context views; 0 if it is not visible.
        gaussians: Number of Gaussians whose main object it is.
        box: Upright bounding box in scene units, aligned to the room; None without Gaussians.
        metres: True if scene units are metres. False for cameras estimated from photographs, which
            have no scale. None for given cameras, whose unit is unknown.
        views: tuple of str. The context views that show it.
    """

    id: int
    name: str | None
    words: tuple[tuple[str, float], ...]
    confidence: float
    gaussians: int
    box: Box | None
    metres: bool | None
    views: tuple[str, ...]

    __repr__ = short_repr


def list_objects(
    field: SemanticField, texts: Sequence[str] | None, rules: Rules
) -> list[SceneObject]:
    """Describe every object of a field that is not removed, in order of ids.

    ``texts`` as for :func:`rank_words`.
    """
    words = rank_words(field, texts, rules)
    bank, views = field.bank, list(field.cameras)
    cameras = []
    for camera in field.cameras.values():
        shrink = min(1.0, RENDERED_SIDE / max(camera.width, camera.height))
        size = round(camera.width * shrink), round(camera.height * shrink)
        cameras.append(camera.resize(*size))
    looks = [field.render(camera) for camera in cameras]
    sums, areas = np.zeros(len(bank)), np.zeros(len(bank))
    for look in looks:
        labelled = look.ids > 0
        rows = np.searchsorted(bank.ids, look.ids[labelled])
        areas += np.bincount(rows, minlength=len(bank))
        sums += np.bincount(rows, look.confidence[labelled], minlength=len(bank))
    local_cameras = [field.gaussians.localize(camera) for camera in cameras]
    up = find_room(local_cameras, [look.depth for look in looks]).up
    means, labels = field.gaussians.to_arrays()["means"], field.labels()
    order = np.argsort(labels, kind="stable")
    estimated = any(camera.estimated for camera in cameras)
    objects = []
    for row, id_ in enumerate(bank.ids.tolist()):
        if id_ in field.edits.removed:
            continue
        members = order[slice(*np.searchsorted(labels[order], [id_, id_ + 1]))]
        box = upright_box(means[members], up) if len(members) else None
        objects.append(
            SceneObject(
                id=id_,
                name=field.edits.names.get(id_),
                words=words[row],
                confidence=float(sums[row] / max(areas[row], 1)),
                gaussians=len(members),
                box=box and replace(box, centre=box.centre + field.gaussians.origin),
                metres=False if estimated else None,
                views=tuple(views[view] for view in np.flatnonzero(bank.present[row]).tolist()),
            )
        )
    return objects


def rank_words(
    field: SemanticField, texts: Sequence[str] | None = None, rules: Rules | None = None
) -> list[tuple[tuple[str, float], ...]]:
    """Return the best words of each object of the bank, with relevancies, best first.

    ``texts`` as for :meth:`slgaussian.field.SemanticField.inventory`.
    """
    words = list(dict.fromkeys([*field.edits.taught, *(texts or field.encoder.describing)]))
    relevancies = field.reader.relevancies(words, rules or Rules()).T
    best = np.argsort(-relevancies, axis=1, kind="stable")[:, :MAX_DESCRIBING_WORDS]
    return [
        tuple((words[k], float(scores[k])) for k in rows)
        for scores, rows in zip(relevancies, best, strict=True)
    ]


def name_objects(reader: BankReader) -> dict[int, str]:
    """Return the best word of each object by id; "object ID" where no word fits."""
    words = list(reader.encoder.describing)
    relevancies, names = reader.relevancies(words, Rules()), {}
    for column, id_ in enumerate(reader.bank.ids.tolist()):
        best = relevancies[:, column].argmax()
        fits = relevancies[best, column] > NO_FIT
        names[id_] = words[best] if fits else f"object {id_}"
    return names


def suggest_word(field: SemanticField) -> str | None:
    """Choose the common object whose query in the first view is most confident; None if none is.

    Nothing is rendered: the memory bank has the areas of the objects in the photograph, and which
    of them touch in any view.
    """
    ids, wholes = field.bank.ids, field.bank.wholes
    if field.encoder.calibration is None or wholes is None or not len(wholes.borders):
        return None
    camera = next(iter(field.cameras.values()))
    areas = np.rint(wholes.shares[:, 0] * camera.width * camera.height).astype(int)
    pairs = np.kron(ids[wholes.borders.T], [[1, 0]])  # a column for each pair that touches
    hits = ask(COMMON_OBJECTS, ObjectMap(pairs, ids, areas), field.reader, Rules())
    probabilities = {hit.text: hit.confidence.mask for hit in hits if hit.found and hit.confidence}
    return max(probabilities, key=probabilities.__getitem__, default=None)


def upright_box(points: np.ndarray, up: np.ndarray) -> Box:
    """Fit an upright box to points float [N, 3], N at least 1, with ``up`` a unit vector [3].

    The orientation about ``up`` minimises the ground area. All but :data:`TRIMMED_PERCENT` percent
    of the points lie inside at each end of each axis.
    """
    points = np.asarray(points, np.float64)[:: -(-len(points) // MAX_POINTS)]
    distances = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    points = points[distances <= MAX_RELATIVE_DISTANCE * np.median(distances)]
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    side_b = np.cross(up, side)
    ground = points @ np.stack([side, side_b]).T
    angles = np.arange(TESTED_ORIENTATIONS) * (np.pi / 2 / TESTED_ORIENTATIONS)
    directions = np.stack([np.cos(angles), np.sin(angles)], 1)
    along, across = ground @ directions.T, ground @ np.stack([-directions[:, 1], directions[:, 0]])
    ends = [TRIMMED_PERCENT, 100 - TRIMMED_PERCENT]
    extents = [np.ptp(np.percentile(axis, ends, axis=0), axis=0) for axis in (along, across)]
    area = np.prod(extents, 0)
    best = directions[area.argmin()]
    first = best[0] * side + best[1] * side_b
    axes = np.stack([first, np.cross(up, first), up])
    low, high = np.percentile(points @ axes.T, ends, axis=0)
    if (high - low)[1] > (high - low)[0]:
        axes = np.stack([axes[1], -axes[0], up])
        low, high = np.percentile(points @ axes.T, ends, axis=0)
    return Box((low + high) / 2 @ axes, axes, (high - low) / 2)
