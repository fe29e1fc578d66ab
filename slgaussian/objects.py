"""Describe the objects of a field: best words, size, place and confidence of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slgaussian.geometry.boxes import Box, upright_box
from slgaussian.geometry.room import find_room
from slgaussian.io import short_repr
from slgaussian.language import Encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.vocabulary import load_vocabulary
from slgaussian.scene import Camera

COMMON_OBJECTS = (
    "floor", "wall", "table", "chair", "sofa", "door", "window", "plant", "box", "book",
)  # fmt: skip
"""What is looked for where an encoder has no list of words of its own."""

BEST = 3
"""Words that an object is described by."""

LOOK = 320
"""Longest side, in pixels, of the pictures in which confidence and the room are looked at."""


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a field.

    Attributes
    ----------
    id : int
    name : str or None
        What the user calls it.
    words : tuple of (str, float)
        The texts that fit it best, with their relevancies, best first; up to 0.5 a text fits no
        better than the canonical phrases do.
    confidence : float
        How clearly its pixels in the context views are its own, the mean of
        :attr:`slgaussian.field.FieldView.confidence`; 0 where none shows it.
    gaussians : int
        How many carry it most of all.
    box : Box or None
        Where it is and how large, in scene units; upright as the room is. None without Gaussians.
    metres : bool or None
        Whether scene units are metres. False where cameras were found from photographs, which know
        no scale. None where cameras were given: the unit is theirs, and no file says it.
    views : tuple of str
        The context views that hold it.
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
    bank: MemoryBank,
    words: Sequence[tuple[tuple[str, float], ...]],
    looks: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    cameras: Sequence[Camera],
    views: Sequence[str],
    labels: np.ndarray,
    means: np.ndarray,
    names: Mapping[int, str],
) -> list[SceneObject]:
    """Describe every object of a bank, by id.

    Parameters
    ----------
    bank : MemoryBank
    words : N tuples
        The best texts of each object.
    looks, cameras, views : V each
        Ids int32, confidence float32 and depth float32, all [H, W], as the context cameras show
        them, and the names of these views.
    labels : int32 [M]
        The object of each Gaussian.
    means : float32 [M, 3]
        Their centres, in scene units.
    names : {id: str}
        What the user calls some.
    """
    sums, areas = np.zeros(len(bank)), np.zeros(len(bank))
    for ids, confidence, _ in looks:
        rows = np.searchsorted(bank.ids, ids[ids > 0])
        areas += np.bincount(rows, minlength=len(bank))
        sums += np.bincount(rows, confidence[ids > 0], minlength=len(bank))
    up = find_room(list(cameras), [depth for _, _, depth in looks]).up
    order = np.argsort(labels, kind="stable")
    estimated = any(camera.estimated for camera in cameras)
    objects = []
    for row, id_ in enumerate(bank.ids.tolist()):
        pixels = order[slice(*np.searchsorted(labels[order], [id_, id_ + 1]))]
        objects.append(
            SceneObject(
                id=id_,
                name=names.get(id_),
                words=words[row],
                confidence=float(sums[row] / max(areas[row], 1)),
                gaussians=len(pixels),
                box=upright_box(means[pixels], up) if len(pixels) else None,
                metres=False if estimated else None,
                views=tuple(views[view] for view in np.flatnonzero(bank.present[row]).tolist()),
            )
        )
    return objects


def words_for(encoder: Encoder) -> tuple[str, ...]:
    """Return the words that objects are described by: colours, and the lexicon's nouns for naming.

    For another encoder, which knows any word, some common objects.
    """
    if not isinstance(encoder, Lexicon):
        return COMMON_OBJECTS
    vocabulary = load_vocabulary()
    return tuple(sorted([*vocabulary.colours, *vocabulary.naming]))


def small(camera: Camera) -> Camera:
    """The camera with an image of :data:`LOOK` pixels at most."""
    shrink = min(1.0, LOOK / max(camera.width, camera.height))
    return camera.resized(round(camera.width * shrink), round(camera.height * shrink))
