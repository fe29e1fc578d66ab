"""The control that asks the other views: what one mask lacks, another has. Beyond the paper."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from slgaussian.semantic.hard import HardIndex

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank


class Filled:
    """Copy the label of the source pixel, after pixels without an object took one.

    Theirs is that of the nearest Gaussian of another view, if one is within reach
    (:mod:`slgaussian.semantic.others`). A pixel that has an object keeps it.
    """

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; the weight is 1 or, still unlabelled, 0."""
        from slgaussian.semantic.others import find_others

        others = find_others(gaussians, label_maps.labels.shape)
        filled = replace(label_maps, labels=others.fill(label_maps.labels))
        return HardIndex()(gaussians, filled, bank)
