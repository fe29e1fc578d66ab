"""One vector an object: the mean over views in place of the paper's multi-view memory bank."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.benchmark.baselines.ours import lift_again
from slgaussian.field import SemanticField
from slgaussian.language.bank import MemoryBank


@dataclass(frozen=True)
class NoBank:
    """Ablation: the field with the mean of what its views say about each object."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        return inputs.field.changed(bank=pooled(inputs.bank))


@dataclass(frozen=True)
class SegSplatLike:
    """As SegSplat (arXiv 2511.18386): an index a Gaussian, and a bank of pooled vectors.

    The index of a pixel is the one with most of its light. There are no groups of objects.
    """

    def __call__(self, inputs: Inputs) -> SemanticField:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        bank = replace(pooled(inputs.bank), levels=None, group_features=None)
        return lift_again(inputs, inputs.label_maps, bank, "hard", "exact")


def pooled(bank: MemoryBank) -> MemoryBank:
    """The bank with one view, the mean of all; groups of objects likewise."""
    features = _mean(bank.features, bank.present)
    present = np.any(bank.present, axis=1, keepdims=True)
    groups = bank.group_features
    if groups is not None:
        groups = _mean(groups, np.any(groups, axis=2))
    return replace(bank, features=features, present=present, boxes=None, group_features=groups)


def _mean(features: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Mean of the unit vectors [M, V, C] of the views that are present, made a unit vector again.

    float32 [M, 1, C], rounded to half precision as those of banks are. Where the vectors cancel
    out it is the first of them, and zero where there is none.
    """
    total = features.astype(np.float64).sum(1)
    cancelled = np.linalg.norm(total, axis=1) < 1e-6
    total[cancelled] = features[cancelled, present.argmax(1)[cancelled]]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    mean = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return mean.astype(np.float16).astype(np.float32)[:, None]
