"""The field itself, and its ablations: other strategies, no mask association, no bank of views."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.errors import InputError, did_you_mean
from slgaussian.field import SemanticField
from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language import CODES, load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.semantic import LIFTINGS, load_lifting


@dataclass(frozen=True)
class Ours:
    """The field, as it is or lifted anew with another strategy.

    Attributes
    ----------
    lifting, codes : str, optional
        By name, where not those of the field.

    Raises
    ------
    InputError
        If there is no lifting or strategy of that name.
    """

    lifting: str | None = None
    codes: str | None = None

    def __post_init__(self) -> None:
        for name, table in (("lifting", LIFTINGS), ("codes", CODES)):
            value = getattr(self, name)
            if value is not None and value not in table:
                raise InputError(
                    f"slgaussian {name}: found {value!r}, expected one of {', '.join(table)}"
                    f"{did_you_mean(value, table)}"
                )

    def __call__(self, inputs: Inputs) -> SemanticField:
        """Return the field, lifted anew where a strategy is another."""
        lifting, codes = _strategies(inputs)
        changed = self.lifting or lifting, self.codes or codes
        if changed == (lifting, codes):
            return inputs.field
        return lift_again(inputs, inputs.label_maps, inputs.bank, *changed)


@dataclass(frozen=True)
class NoAssociation:
    """Ablation: the masks of each view are objects of their own, known from that view only."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """Lift the labels that each view was given on its own."""
        geometry, labels = inputs.geometry, inputs.own_labels
        bank = inputs.look_at(geometry.seen, labels, geometry.surroundings, grouped=True)
        return lift_again(inputs, labels, bank, *_strategies(inputs))


@dataclass(frozen=True)
class NoBank:
    """Ablation: the field with the mean of what its views say about each object."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """Return the field with a bank of one view."""
        return inputs.field.changed(bank=pooled(inputs.bank))


def pooled(bank: MemoryBank) -> MemoryBank:
    """Return the bank with one view, the mean of all; groups of objects likewise."""
    features = _mean(bank.features, bank.present)
    present = np.any(bank.present, axis=1, keepdims=True)
    groups = bank.group_features
    if groups is not None:
        groups = _mean(groups, np.any(groups, axis=2))
    return replace(bank, features=features, present=present, boxes=None, group_features=groups)


def _mean(features: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return the mean of unit vectors [M, V, C] of the present views as float32 [M, 1, C].

    It is a unit vector again, rounded to half precision as those of banks are. Where the vectors
    cancel out it is the first of them, and zero where there is none.
    """
    total = features.astype(np.float64).sum(1)
    cancelled = np.linalg.norm(total, axis=1) < 1e-6
    total[cancelled] = features[cancelled, present.argmax(1)[cancelled]]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    mean = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    return mean.astype(np.float16).astype(np.float32)[:, None]


def lift_again(
    inputs: Inputs, label_maps: LabelMaps, bank: MemoryBank, lifting: str, codes: str
) -> SemanticField:
    """Make a field of the same Gaussians with other objects or strategies.

    ``bank`` is of the objects of ``label_maps``; its codes are drawn anew.
    """
    strategy = load_codes(codes, **inputs.settings.get(codes, {}))
    drawn = strategy(label_maps, rng_for(inputs.seed, inputs.sample.content, "codes"))
    bank = replace(bank, codes=drawn)
    lift = load_lifting(lifting, **inputs.settings.get(lifting, {}))
    return inputs.field.changed(
        gaussians=lift(inputs.gaussians, label_maps, bank),
        bank=bank,
        settings={**inputs.field.settings, "lifting": lifting, "codes": codes},
    )


def _strategies(inputs: Inputs) -> tuple[str, str]:
    """Return lifting and code strategy of the field."""
    settings = inputs.field.settings
    return settings.get("lifting", "hard"), settings.get("codes", "separated")
