"""Label maps: the object id of every pixel of every view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slgaussian.errors import InputError
from slgaussian.io import short_repr

MIN_WEIGHT = 0.5
"""A pixel has an object if labelled Gaussians have at least this sum of blending weights."""


@dataclass(frozen=True, eq=False)
class LabelMaps:
    """Object ids that are consistent across views (the S_i of the paper, section 3.2).

    Attributes:
        labels: int32 [V, H, W]. Object ids above 0; 0 is unassigned. An id means the same object in
            every view.
        margin: float32 [V, H, W]. Margin of the vote: (votes for the winner - votes for the
            runner-up) / replicas, in [0, 1].
        computed: Largest number of copies of a view that were segmented for the vote; None if
            unknown.
    """

    labels: np.ndarray
    margin: np.ndarray
    computed: int | None = field(default=None, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.labels.ndim != 3 or self.labels.dtype != np.int32:
            raise InputError(
                f"label maps: found {self.labels.dtype} {self.labels.shape}, expected int32 [V,H,W]"
            )
        if self.margin.shape != self.labels.shape:
            raise InputError(
                f"label maps: margin is {self.margin.shape}, labels are {self.labels.shape}"
            )
        if self.labels.size and self.labels.min() < 0:
            raise InputError(f"label maps: negative id {self.labels.min()}; ids start at 1")

    @property
    def ids(self) -> np.ndarray:
        """Sorted object ids in use, int32 [N]."""
        ids = np.unique(self.labels)
        return ids[ids > 0]

    @property
    def seen_once(self) -> np.ndarray:
        """Sorted ids of the objects that only one view shows, int32."""
        return self.ids[(self.areas() > 0).sum(1) == 1]

    def split(self, count: int) -> tuple[LabelMaps, LabelMaps]:
        """Return the maps of the first ``count`` views, and those of the others."""
        first, others = slice(count), slice(count, None)
        return (
            LabelMaps(self.labels[first], self.margin[first], self.computed),
            LabelMaps(self.labels[others], self.margin[others], self.computed),
        )

    def areas(self) -> np.ndarray:
        """Count the pixels of each object in each view, int64 [N, V], rows as in :attr:`ids`."""
        ids = self.ids
        # By row, not by id: ids of other programs may be in the millions.
        counts = [
            np.bincount(np.searchsorted(ids, view[view > 0]), minlength=len(ids))
            for view in self.labels
        ]
        return np.stack(counts, 1)
