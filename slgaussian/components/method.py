"""The whole method: a part of every kind, and what they share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slgaussian.components.component import Component
from slgaussian.components.registry import KINDS
from slgaussian.errors import InputError, did_you_mean

KEEP = ("needed", "all")
"""Which Gaussians a field keeps: those that the scene needs, or all that were predicted."""

BANK = ("groups", "objects")
"""What a memory bank holds: objects and the groups that a word may mean as one, or, as in the
paper, objects alone."""

OWN = ("replicas", "seed", "keep", "bank")
"""The settings of the method that belong to no part."""

PartSettings = Mapping[str, Mapping[str, Any]]
"""Settings of parts by the part's name, as in ``{"mvsplat": {"checkpoint": "re10k.ckpt"}}``."""


@dataclass(frozen=True, init=False)
class Method:
    """How a field is built.

    Parameters
    ----------
    predictor, proposer, tracker, encoder, codes, lifting : str or Component
        The part of each kind, by its name or with its settings.
    replicas : int
        How many copies of each view vote on its labels (five in the paper, section 3.2).
    seed : int
        Of everything random: the ID codes, and what parts of other packages draw. The same seed
        gives the same bytes, whatever scene and views are called.
    keep : "needed" or "all"
        Whether even neighbours become larger Gaussians (:mod:`slgaussian.rasterize.merging`), or
        the field has all that were predicted, in the paper one a pixel.
    bank : "groups" or "objects"
        Whether the memory bank holds groups of objects too (:mod:`slgaussian.masks.levels`), and a
        text is scored on both, or, as in the paper, objects alone and the best of their views.
    settings : mapping, optional
        Settings of the parts that are given by name, each under its name:
        ``{"mvsplat": {"checkpoint": "re10k.ckpt"}, "sam": {"model": "facebook/sam-vit-base"}}``.

    Raises
    ------
    InputError
        If there is no such part or setting, or a file cannot be read.
    """

    predictor: Component
    proposer: Component
    tracker: Component
    encoder: Component
    codes: Component
    lifting: Component
    replicas: int
    seed: int
    keep: str
    bank: str

    def __init__(
        self,
        predictor: str | Component = KINDS["predictor"].default,
        proposer: str | Component = KINDS["proposer"].default,
        tracker: str | Component = KINDS["tracker"].default,
        encoder: str | Component = KINDS["encoder"].default,
        codes: str | Component = KINDS["codes"].default,
        lifting: str | Component = KINDS["lifting"].default,
        replicas: int = 5,
        seed: int = 0,
        keep: str = KEEP[0],
        bank: str = BANK[0],
        settings: PartSettings | None = None,
    ) -> None:
        given = dict(
            zip(KINDS, (predictor, proposer, tracker, encoder, codes, lifting), strict=True)
        )
        own = dict(settings or {})
        names = [part for part in given.values() if isinstance(part, str)]
        for name in own:
            if name not in names:
                takers = (part if isinstance(part, str) else part.name for part in given.values())
                raise InputError(
                    f"settings: found some of {name!r}, expected none but those of the predictor, "
                    "proposer, tracker, encoder, codes and lifting, which are "
                    f"{', '.join(map(repr, takers))}"
                )
        for kind, part in given.items():
            made = part if isinstance(part, Component) else Component.of(kind, part, own.get(part))
            object.__setattr__(self, kind, made)
        for name, value, choices in (("keep", keep, KEEP), ("bank", bank, BANK)):
            if value not in choices:
                near = did_you_mean(value, choices)
                raise InputError(f"{name}: found {value!r}, expected {' or '.join(choices)}{near}")
        for name, said in zip(OWN, (replicas, seed, keep, bank), strict=True):
            object.__setattr__(self, name, said)

    @property
    def components(self) -> tuple[Component, ...]:
        """The parts, in the order in which they work."""
        return tuple(getattr(self, kind) for kind in KINDS)

    def identity(self) -> dict[str, Any]:
        """What a field depends on besides the sample, as cache keys and artifacts hold it.

        The name of each part, replicas, seed, what is kept and what the bank holds, and under a
        part's name its settings, files by content; of a part without settings nothing.
        """
        named = {part.kind: part.name for part in self.components}
        tables = {part.name: part.identity() for part in self.components if part.settings}
        own = {name: getattr(self, name) for name in OWN}
        return {**named, **own, **tables}

    def check(self) -> None:
        """Load every part once, so that what cannot work is said before the others have worked.

        Raises
        ------
        InputError
            If a value is out of bounds, or files do not fit.
        """
        for part in self.components:
            part.load()
