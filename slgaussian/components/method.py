"""The whole method: a component of every kind, and the fields that they share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slgaussian.components.component import Component
from slgaussian.components.registry import KINDS
from slgaussian.errors import InputError, did_you_mean

KEEP = ("needed", "all")
"""Gaussians that a field keeps: those that the scene needs, or all that were predicted."""

BANK = ("groups", "objects")
"""Contents of a memory bank: objects and the groups that a word may mean as one, or, as in the
paper, objects alone."""

VOTES = ("views", "copies")
"""Who votes on label maps: copies of a view that differ, and then all views on what is one object;
or, as in the paper, all copies of each view and nobody else."""

OWN = ("replicas", "votes", "seed", "keep", "bank")
"""The fields of the method that belong to no component."""


@dataclass(frozen=True, init=False)
class Method:
    """The method by which a field is built.

    Parameters
    ----------
    predictor, proposer, tracker, encoder, codes, lifting : str or Component
        The component of each kind, by its name or with its fields.
    replicas : int
        How many copies of each view vote on its labels (five in the paper, section 3.2).
    votes : "views" or "copies"
        Who votes besides; see :func:`slgaussian.masks.associate.associate`.
    seed : int
        Of everything random: ID codes, and what components of other packages draw. The same seed
        gives the same bytes, whatever scene and views are called.
    keep : "needed" or "all"
        Whether even neighbours become larger Gaussians (:mod:`slgaussian.rasterize.merging`), or
        the field has all that were predicted, in the paper one a pixel.
    bank : "groups" or "objects"
        Whether the memory bank holds groups of objects too (:mod:`slgaussian.masks.levels`), and a
        text is scored on both, or, as in the paper, objects alone and the best of their views.
    settings : mapping, optional
        Fields of the components that are given by name, each under its name:
        ``{"mvsplat": {"checkpoint": "re10k.ckpt"}, "sam": {"model": "facebook/sam-vit-base"}}``.

    Raises
    ------
    InputError
        If there is no such component or field, or a file cannot be read.
    """

    predictor: Component
    proposer: Component
    tracker: Component
    encoder: Component
    codes: Component
    lifting: Component
    replicas: int
    votes: str
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
        votes: str = VOTES[0],
        settings: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        chosen = (predictor, proposer, tracker, encoder, codes, lifting)
        fields = dict(settings or {})
        for name in fields:
            if name not in [choice for choice in chosen if isinstance(choice, str)]:
                takers = (choice if isinstance(choice, str) else choice.name for choice in chosen)
                raise InputError(
                    f"settings: found some of {name!r}, expected none but those of the predictor, "
                    "proposer, tracker, encoder, codes and lifting, which are "
                    f"{', '.join(map(repr, takers))}"
                )
        for kind, choice in zip(KINDS, chosen, strict=True):
            if isinstance(choice, Component):
                component = choice
            else:
                component = Component.of(kind, choice, fields.get(choice))
            object.__setattr__(self, kind, component)
        choices_of = ("keep", keep, KEEP), ("bank", bank, BANK), ("votes", votes, VOTES)
        for name, text, choices in choices_of:
            if text not in choices:
                near = did_you_mean(text, choices)
                raise InputError(f"{name}: found {text!r}, expected {' or '.join(choices)}{near}")
        for name, value in zip(OWN, (replicas, votes, seed, keep, bank), strict=True):
            object.__setattr__(self, name, value)

    @property
    def components(self) -> tuple[Component, ...]:
        """The components, in the order in which they work."""
        return tuple(getattr(self, kind) for kind in KINDS)

    def identity(self) -> dict[str, Any]:
        """Return what a field depends on besides the sample, as cache keys and artifacts hold it.

        The name of each component, the fields of :data:`OWN`, and under a component's name its
        fields, files by content; of a component without fields nothing.
        """
        named = {component.kind: component.name for component in self.components}
        tables = {each.name: each.identity() for each in self.components if each.settings}
        shared = {name: getattr(self, name) for name in OWN}
        return {**named, **shared, **tables}

    def check(self) -> None:
        """Load every component once, so that an error comes before any has worked.

        Raises
        ------
        InputError
            If a value is out of bounds, or files do not fit.
        """
        for component in self.components:
            component.load()
