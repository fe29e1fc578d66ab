"""The field itself, lifted and coded in any way, and what it is without mask association."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
            given = getattr(self, name)
            if given is not None and given not in table:
                raise InputError(
                    f"slgaussian {name}: found {given!r}, expected one of {', '.join(table)}"
                    f"{did_you_mean(given, table)}"
                )

    def __call__(self, inputs: Inputs) -> SemanticField:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        lifting, codes = _strategies(inputs, self.lifting, self.codes)
        if (lifting, codes) == _strategies(inputs):
            return inputs.field
        return lift_again(inputs, inputs.label_maps, inputs.bank, lifting, codes)


@dataclass(frozen=True)
class NoAssociation:
    """Ablation: the masks of each view are objects of their own, known from that view only."""

    def __call__(self, inputs: Inputs) -> SemanticField:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        geometry, labels = inputs.geometry, inputs.own_labels
        bank = inputs.look_at(geometry.seen, labels, geometry.surroundings, grouped=True)
        return lift_again(inputs, labels, bank, *_strategies(inputs))


def lift_again(
    inputs: Inputs, label_maps: LabelMaps, bank: MemoryBank, lifting: str, codes: str
) -> SemanticField:
    """A field of the same Gaussians with other objects or strategies.

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


def _strategies(
    inputs: Inputs, lifting: str | None = None, codes: str | None = None
) -> tuple[str, str]:
    """Lifting and code strategy: those given, otherwise those of the field."""
    own = inputs.field.settings
    return lifting or own.get("lifting", "hard"), codes or own.get("codes", "separated")
