"""The multi-view language memory bank: for each ID code, the object's feature in every view."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import cv2
import numpy as np

from slgaussian.errors import InputError, check_type
from slgaussian.geometry.room import Surroundings
from slgaussian.io import short_repr
from slgaussian.labels import LabelMaps
from slgaussian.language import Encoder
from slgaussian.language.wholes import Wholes
from slgaussian.scene import View

UNIT_TOLERANCE = 1e-3
"""Largest allowed | |L| - 1 |. Rounding to half precision changes a length by at most 2^-11, half
of that; unnormalised features are refused."""

HALF_PRECISION = {"features", "group_features"}
"""Arrays that are stored as float16."""


@dataclass(frozen=True, eq=False)
class MemoryBank:
    """``{ID: {L_1 ... L_V}}`` of section 3.2, as arrays over N objects.

    The paper stores a zero vector where a view does not show the object. A zero vector would score
    0.5 against every text, so here such a view is marked absent and is not scored. Features are
    stored in half precision, and :func:`build_bank` rounds them accordingly.

    Attributes:
        ids: int32 [N]. Object ids as in the label maps, positive and ascending.
        codes: float32 [N, 3]. ID codes in [0, 1], all different.
        features: float32 [N, V, C]. Unit vectors of the encoder, within
            :data:`UNIT_TOLERANCE`; zero where absent.
        present: bool [N, V]. True where the view shows the object.
        boxes: int32 [N, V, 4], optional. Bounding box of the object in each view, in pixels: first
            column and row, then last column and row plus one; zeros where absent.
        levels: int32 [L, N], optional. Group of each object at L levels: its own row n if it is
            alone, else N + g for group g. Texts are then scored on groups too; see
            :class:`slgaussian.language.scoring.Scorer`.
        group_features: float32 [G, V, C], with ``levels``. Unit vectors of the groups, zero where a
            view shows none of a group's objects.
        class_scores: uint8 [N + G, V, 1000], optional. ImageNet log-probabilities of objects and,
            after them, groups, quantised by :func:`slgaussian.language.classifier.quantize`;
            zeros where absent.
        photograph_scores: uint8 [V, 1000], with ``class_scores``. Means over whole photographs.
        wholes: Candidates for answers; without it, an answer is all near-best objects.

    Raises:
        InputError: If an array is invalid; the message names the array and the object.
    """

    ids: np.ndarray
    codes: np.ndarray
    features: np.ndarray
    present: np.ndarray
    boxes: np.ndarray | None = None
    levels: np.ndarray | None = None
    group_features: np.ndarray | None = None
    class_scores: np.ndarray | None = None
    photograph_scores: np.ndarray | None = None
    wholes: Wholes | None = field(default=None, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = len(self.ids)
        if n and (self.ids[0] < 1 or (np.diff(self.ids) <= 0).any()):
            raise InputError("memory bank ids: expected positive ids in ascending order")
        if self.codes.shape != (n, 3) or not ((self.codes >= 0) & (self.codes <= 1)).all():
            raise InputError(
                f"memory bank codes: found {self.codes.shape}, or NaN or numbers outside [0, 1], "
                f"expected ({n}, 3) in [0, 1]"
            )
        if len(np.unique(self.codes, axis=0)) != n:
            raise InputError("memory bank codes: two objects share one code")
        _check_lengths("features: object", self.ids, self.features, self.present)
        for name, companion in (
            ("levels", "group_features"),
            ("class_scores", "photograph_scores"),
        ):
            if (getattr(self, name) is None) != (getattr(self, companion) is None):
                raise InputError(f"memory bank: {name} and {companion} go together, found only one")
        if self.levels is not None and self.group_features is not None:
            groups = len(self.group_features)
            single = self.levels == np.arange(n)
            if not (single | ((self.levels >= n) & (self.levels < n + groups))).all():
                raise InputError(
                    f"memory bank levels: expected each object's own row or one of the {groups} "
                    f"groups, {n} to {n + groups - 1}"
                )
            present_groups = np.any(self.group_features, axis=2)
            _check_lengths(
                "group_features: group", range(groups), self.group_features, present_groups
            )

    def __len__(self) -> int:
        return len(self.ids)

    def row(self, object_id: int) -> int:
        """Return the row of an object; InputError if there is none with this id."""
        row = int(np.searchsorted(self.ids, object_id))
        if row == len(self) or self.ids[row] != object_id:
            raise InputError(
                f"object {object_id}: is not in the field, which has {len(self)} objects; "
                "`slgaussian objects list` has them"
            )
        return row

    def check_ids(self, ids: Iterable[int]) -> frozenset[int]:
        """Return a set of ids of objects; InputError if there is none with one of them."""
        return frozenset(int(self.ids[self.row(id_)]) for id_ in ids)

    def mean_features(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of the objects that some view shows, and their mean unit features.

        int64 [R] and float32 [R, C], means over the views.
        """
        rows = np.flatnonzero(self.present.any(1))
        means = [self.features[r, self.present[r]].mean(0, dtype=np.float64) for r in rows]
        units = [(mean / np.linalg.norm(mean)).astype(np.float32) for mean in means]
        return rows, np.array(units, np.float32).reshape(-1, self.features.shape[2])

    @property
    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Features float32 [N + G, V, C] and presence bool [N + G, V] of objects, then groups."""
        if self.group_features is None:
            return self.features, self.present
        features = np.concatenate([self.features, self.group_features])
        return features, np.concatenate([self.present, np.any(self.group_features, axis=2)])

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that are not None, as stored in ``bank.npz``: features as float16."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "wholes"}
        stored = {name: array for name, array in arrays.items() if array is not None}
        stored |= {} if self.wholes is None else self.wholes.to_arrays()
        half = {name: stored[name].astype(np.float16) for name in HALF_PRECISION & stored.keys()}
        return stored | half

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray]) -> MemoryBank:
        """Inverse of :meth:`to_arrays`."""
        arrays = dict(arrays)
        wholes = Wholes.from_arrays(arrays)
        half = HALF_PRECISION & arrays.keys()
        arrays |= {name: np.asarray(arrays[name], np.float32) for name in half}
        return MemoryBank(**arrays, wholes=wholes)


def build_bank(
    views: Sequence[View],
    label_maps: LabelMaps,
    encoder: Encoder,
    codes: np.ndarray,
    surroundings: Sequence[Surroundings] | None = None,
    groups: np.ndarray | None = None,
    wholes: Wholes | None = None,
) -> MemoryBank:
    """Encode every object, and every group of objects, in each view that shows it.

    Args:
        views: The V photographs of the label maps, in the same order.
        label_maps: labels [V, H, W].
        codes: float32 [N, 3]. One code for each of ``label_maps.ids``, in that order.
        surroundings: 3D positions of the pixels of each view, for encoders that use them.
        groups: int [L, N], optional. Group of each object at each level, from
            :func:`slgaussian.masks.levels.group_objects`. Groups of a single object are dropped,
            and equal groups of several levels are merged.
        wholes: From the same function.

    Raises:
        InputError: If views and label maps do not match, or there is no object at all.
    """
    from slgaussian.kernels.work_sharing import share_items

    ids = label_maps.ids
    check_type(encoder, Encoder, "encoder: expected a subclass of slgaussian.language.Encoder")
    if len(ids) == 0:
        raise InputError("memory bank: the label maps hold no object; nothing could be queried")
    sizes = [view.image.shape[:2] for view in views]
    if sizes != [labels.shape for labels in label_maps.labels]:
        raise InputError(
            f"memory bank: views are {sizes} and label maps {label_maps.labels.shape}, expected "
            "one map of the same size for each view"
        )
    present = label_maps.areas() > 0
    members, levels = _members(np.zeros((0, len(ids))) if groups is None else groups)
    arounds: Sequence[Surroundings | None] = surroundings or [None] * len(views)
    boxes = np.zeros((*present.shape, 4), np.int32)
    features, classes, photographs = [], [], []
    of_views = zip(views, label_maps.labels, present.T, arounds, strict=True)
    for v, (view, labels, visible, around) in enumerate(of_views):
        masks = labels == ids[visible][:, None, None]
        for row, mask in zip(np.flatnonzero(visible), masks, strict=True):
            x, y, w, h = cv2.boundingRect(mask.view(np.uint8))
            boxes[row, v] = x, y, x + w, y + h
        visible_groups = (members & visible).any(1)
        unions = np.zeros((visible_groups.sum(), *labels.shape), bool)
        rows = np.searchsorted(ids, labels[labels > 0])
        unions[:, labels > 0] = members[visible_groups][:, rows]
        # One call for both, so that the encoder processes the photograph once.
        regions = np.concatenate([masks, unions])
        all_visible = np.concatenate([visible, visible_groups])
        tasks: list[Callable[[], Any]] = [
            partial(encoder.encode_regions, view.image, regions, around)
        ]
        if encoder.classifies:
            tasks.append(partial(encoder.class_scores, view.image, regions))
        encoded, *scores = share_items(lambda task: task(), tasks)
        features.append(_scatter(encoded.astype(np.float16), all_visible))
        for region_scores, photograph_scores in scores:
            classes.append(_scatter(region_scores, all_visible))
            photographs.append(photograph_scores)
    nodes = np.stack(features, 1).astype(np.float32)
    return MemoryBank(
        ids,
        np.asarray(codes, np.float32),
        nodes[: len(ids)],
        present,
        boxes,
        None if groups is None else levels,
        None if groups is None else nodes[len(ids) :],
        np.stack(classes, 1) if classes else None,
        np.stack(photographs) if classes else None,
        wholes,
    )


def _members(groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the groups of several objects, bool [G, N], and ``levels`` of :class:`MemoryBank`."""
    count = groups.shape[1]
    levels = np.tile(np.arange(count, dtype=np.int32), (len(groups), 1))
    rows: dict[tuple[bool, ...], int] = {}
    for level, numbers in enumerate(groups):
        for number in np.unique(numbers):
            member = numbers == number
            if member.sum() > 1:
                levels[level, member] = count + rows.setdefault(tuple(member), len(rows))
    return np.array(list(rows), bool).reshape(-1, count), levels


def _scatter(values: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Scatter values [M, C] to the rows ``present`` bool [N] of zeros [N, C]."""
    column = np.zeros((len(present), values.shape[1]), values.dtype)
    column[present] = values
    return column


def _check_lengths(
    kind: str, names: Sequence[int] | np.ndarray, features: np.ndarray, present: np.ndarray
) -> None:
    """Raise InputError unless vectors [N, V, C] have length 1 where present, and 0 elsewhere."""
    lengths = np.linalg.norm(features.astype(np.float64), axis=2)
    for row, view in np.argwhere(~(np.abs(lengths - present) <= UNIT_TOLERANCE)):
        raise InputError(
            f"memory bank {kind} {names[row]} in view {view} has length "
            f"{lengths[row, view]:.4g}, expected {float(present[row, view]):g}"
        )
