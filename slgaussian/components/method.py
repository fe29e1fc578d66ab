"""The method: a component of every kind, and common fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from slgaussian.components.component import Component
from slgaussian.components.registry import KINDS
from slgaussian.errors import InputError, did_you_mean

KEEP = ("needed", "all")
"""Gaussians of a field: merged where neighbours are similar, or all predicted Gaussians."""

BANK = ("groups", "objects")
"""Entries of a memory bank: objects and groups of objects that a word may denote, or, as in the
paper, objects alone."""

VOTES = ("views", "copies")
"""Voting on label maps: distinct copies of a view vote per pixel, then all views vote on which
regions are one object; or, as in the paper, all copies of each view vote and nothing else."""

METHOD_FIELDS = ("replicas", "votes", "seed", "keep", "bank")
"""Fields of the method that belong to no component."""


@dataclass(frozen=True, init=False)
class Method:
    """Configuration of all steps that build a field.

    Parameters
    ----------
    predictor, proposer, tracker, encoder, codes, lifting : str or Component
        The component of each kind: its name, or a configured component.
    replicas : int
        Number of copies of each view that vote on its labels (five in the paper, section 3.2).
    votes : "views" or "copies"
        Voters on labels; see :func:`slgaussian.masks.associate.associate`.
    seed : int
        Seed of all random numbers: ID codes, and those of components of other packages. The same
        seed gives the same bytes, independent of the names of scene and views.
    keep : "needed" or "all"
        Whether similar neighbours are merged (:mod:`slgaussian.rasterize.merging`), or the field
        has all predicted Gaussians, in the paper one per pixel.
    bank : "groups" or "objects"
        Whether the memory bank also has groups of objects (:mod:`slgaussian.masks.levels`), and
        texts are scored on both; or, as in the paper, only objects, each by its best view.
    settings : mapping, optional
        Fields of components that are given by name, by this name:
        ``{"mvsplat": {"checkpoint": "re10k.ckpt"}, "sam": {"model": "facebook/sam-vit-base"}}``.

    Raises
    ------
    InputError
        If a component or field is unknown, or a file cannot be read.
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
                names = (choice if isinstance(choice, str) else choice.name for choice in chosen)
                raise InputError(
                    f"settings: found some of {name!r}, expected only those of the predictor, "
                    "proposer, tracker, encoder, codes and lifting, which are "
                    f"{', '.join(map(repr, names))}"
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
        for name, value in zip(METHOD_FIELDS, (replicas, votes, seed, keep, bank), strict=True):
            object.__setattr__(self, name, value)

    @property
    def components(self) -> tuple[Component, ...]:
        """The components, in the order in which they are used."""
        return tuple(getattr(self, kind) for kind in KINDS)

    def identity(self) -> dict[str, Any]:
        """Return all inputs of a field except the sample, for cache keys and artifacts.

        The name of each component by kind, the :data:`METHOD_FIELDS`, and the fields of each
        component by its name, files by digest.
        """
        named = {component.kind: component.name for component in self.components}
        tables = {each.name: each.identity() for each in self.components if each.settings}
        shared = {name: getattr(self, name) for name in METHOD_FIELDS}
        return {**named, **shared, **tables}

    def check(self) -> None:
        """Load every component once, to detect errors before the work.

        Raises
        ------
        InputError
            If a value is out of bounds, or files are invalid.
        """
        for component in self.components:
            component.load()
