"""The objects of a field under the ids that they had in one of fewer photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from slgaussian.field import SemanticField

HALF = 0.5
"""Two objects are one if they share this part of the pixels of either."""


def with_ids_of(
    before: SemanticField, after: SemanticField, views: Mapping[str, str]
) -> SemanticField:
    """The field ``after`` whose objects have the ids that they have in ``before``.

    Those that share most come first; of several that became one, the id of one stays. Objects that
    ``before`` does not have take ids above all of its own. Nothing but ids changes, and the order
    of the bank, which is theirs.

    Parameters
    ----------
    before, after : SemanticField
        Their common views have one size.
    views : mapping str -> str
        What views of ``before`` are called in ``after``.
    """
    if not len(before.bank):
        return after
    ids = np.zeros(len(after.bank), np.int32)
    taken: set[int] = set()
    for row, old in _pairs(before, after, views):
        if not ids[row] and old not in taken:
            ids[row] = old
            taken.add(old)
    new = ids == 0
    ids[new] = before.bank.ids.max() + 1 + np.arange(new.sum())
    return _renumbered(after, ids)


def _pairs(
    before: SemanticField, after: SemanticField, views: Mapping[str, str]
) -> list[tuple[int, int]]:
    """(row in the bank of ``after``, id in ``before``) of objects that may be one, best first."""
    at, old = _labelled(before, list(views))
    also, new = _labelled(after, list(views.values()))
    _, here, there = np.intersect1d(at, also, return_indices=True)
    rows = np.searchsorted(after.bank.ids, new[there])
    columns = np.searchsorted(before.bank.ids, old[here])
    table = np.zeros((len(after.bank), len(before.bank)), np.int64)
    np.add.at(table, (rows, columns), 1)
    least = np.minimum(table.sum(1)[:, None], table.sum(0))
    found = np.argwhere((table > 0) & (table >= HALF * least))
    order = np.argsort(-table[tuple(found.T)], kind="stable")
    return [(int(row), int(before.bank.ids[column])) for row, column in found[order]]


def _labelled(field: SemanticField, views: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the named views that gave birth to Gaussians of objects, and which: int [M] each.

    The pixels are numbered through all the views, in the order of their names here.
    """
    camera = next(iter(field.cameras.values()))
    size = camera.width * camera.height
    names = list(field.cameras)
    place = np.full(len(names), -1)
    for k, name in enumerate(views):
        if name in field.cameras:
            place[names.index(name)] = k
    source, labels = field.gaussians.source.numpy().astype(np.int64), field.labels()
    view = place[source // size]
    kept = (view >= 0) & (labels > 0)
    pixels, first = np.unique(view[kept] * size + source[kept] % size, return_index=True)
    return pixels, labels[kept][first]


def _renumbered(field: SemanticField, ids: np.ndarray) -> SemanticField:
    """The field with other ids int32 [N] for the rows of its bank, all different."""
    order = np.argsort(ids)
    bank, gaussians = field.bank, field.gaussians
    levels = bank.levels
    if levels is not None:
        levels = levels[:, order]
        levels = np.where(levels < len(ids), np.arange(len(ids), dtype=np.int32), levels)
    moved = replace(
        bank,
        ids=ids[order],
        codes=bank.codes[order],
        features=bank.features[order],
        present=bank.present[order],
        boxes=None if bank.boxes is None else bank.boxes[order],
        levels=levels,
    )
    if not bank.dimension:  # Gaussians carry rows of the bank
        row_of = torch.from_numpy(np.append(0, 1 + np.argsort(order)))
        features = gaussians.require_features().clone()
        features[:, 0] = row_of[features[:, 0].long()].to(features.dtype)
        gaussians = replace(gaussians, features=features)
    return field.changed(gaussians=gaussians, bank=moved)
