"""The field itself, and its ablations: no mask association, no bank of views."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.field import SemanticField
from slgaussian.kernels.seeding import rng_for
from slgaussian.language import load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.semantic import load_lifting


@dataclass(frozen=True)
class Ours:
    """The field, unchanged."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """Return the field."""
        return inputs.field


@dataclass(frozen=True)
class NoAssociation:
    """Ablation: no association, so each mask of each view is a separate object."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """Lift the label maps without association in the same way as the field."""
        geometry, labels = inputs.geometry, inputs.own_labels
        bank = inputs.look_at(geometry.frames, labels, geometry.surroundings, grouped=True)
        used = {"lifting": "hard", "codes": "separated"} | dict(inputs.field.settings)
        codes = load_codes(used["codes"], **inputs.settings.get(used["codes"], {}))
        drawn = codes(labels, rng_for(inputs.seed, inputs.sample.content, "codes"))
        bank = replace(bank, codes=drawn)
        lift = load_lifting(used["lifting"], **inputs.settings.get(used["lifting"], {}))
        return inputs.field.with_changes(
            gaussians=lift(inputs.gaussians, labels, bank), bank=bank, settings=used
        )


@dataclass(frozen=True)
class NoBank:
    """Ablation: the field with the mean feature over views of each object."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """Return the field with a memory bank of one view."""
        return inputs.field.with_changes(bank=pool_views(inputs.bank))


def pool_views(bank: MemoryBank) -> MemoryBank:
    """Return the bank with one view, the mean of all, also for groups of objects."""
    groups = bank.group_features
    return replace(
        bank,
        features=_mean(bank.features, bank.present),
        present=np.any(bank.present, axis=1, keepdims=True),
        boxes=None,
        group_features=None if groups is None else _mean(groups, np.any(groups, axis=2)),
        # Class scores belong to a view; a mean view has none.
        class_scores=None,
        photograph_scores=None,
    )


def _mean(features: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return the mean of unit vectors [M, V, C] of the present views as float32 [M, 1, C].

    It is normalised and rounded to half precision, as in memory banks. If the vectors cancel it is
    the first of them.
    """
    total = features.astype(np.float64).sum(1)
    cancelled = np.linalg.norm(total, axis=1) < 1e-6
    total[cancelled] = features[cancelled, present.argmax(1)[cancelled]]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    mean = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return mean.astype(np.float16).astype(np.float32)[:, None]
