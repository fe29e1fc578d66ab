"""The method: a component of every kind, and common fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, InstanceOf
from pydantic.json_schema import SkipJsonSchema

from slgaussian.components.config import ComponentConfig, Config
from slgaussian.components.registry import KINDS, configure
from slgaussian.errors import InputError


class BuildConfig(Config):
    """Settings of the method that belong to no component."""

    replicas: int = Field(5, ge=1, description="Copies of each view that vote on its labels.")
    votes: Literal["views", "copies"] = Field(
        "views",
        examples=["views", "copies"],
        description="Voters on labels: views (distinct copies of a view, then all views on which "
        "regions are one object), or copies (all copies of each view, as the paper).",
    )
    seed: int = Field(0, ge=0, description="Seed of all random numbers.")
    keep: Literal["needed", "all"] = Field(
        "needed",
        examples=["needed", "all"],
        description="Gaussians of a field: needed (similar neighbours are merged), or all "
        "predicted ones.",
    )
    bank: Literal["groups", "objects"] = Field(
        "groups",
        examples=["groups", "objects"],
        description="Entries that a text is scored on: groups (and objects), or objects alone (as "
        "the paper).",
    )


Chosen = SkipJsonSchema[InstanceOf[ComponentConfig]]
"""Config of a component; JSON schemas leave it out."""


class Method(BuildConfig):
    """Configuration of all steps that build a field.

    Args:
        predictor, proposer, tracker, encoder, codes, lifting: The component of each kind: its name,
            or its config.
        settings: Fields of components that are given by name, by this name: ``{"mvsplat":
            {"checkpoint": "re10k.ckpt"}, "sam": {"model": "facebook/sam-vit-base"}}``.
        **build: Fields of :class:`BuildConfig`. The same seed gives the same bytes, independent of
            the names of scene and views.

    Raises:
        InputError: If a component or field is unknown, or a file cannot be read.
    """

    predictor: Chosen
    proposer: Chosen
    tracker: Chosen
    encoder: Chosen
    codes: Chosen
    lifting: Chosen

    def __init__(
        self,
        predictor: str | ComponentConfig = KINDS["predictor"].default,
        proposer: str | ComponentConfig = KINDS["proposer"].default,
        tracker: str | ComponentConfig = KINDS["tracker"].default,
        encoder: str | ComponentConfig = KINDS["encoder"].default,
        codes: str | ComponentConfig = KINDS["codes"].default,
        lifting: str | ComponentConfig = KINDS["lifting"].default,
        settings: Mapping[str, Mapping[str, Any]] | None = None,
        **build: Any,
    ) -> None:
        choices = predictor, proposer, tracker, encoder, codes, lifting
        for name in settings or {}:
            if not any(name == choice for choice in choices):
                names = ", ".join(repr(getattr(c, "name", c)) for c in choices)
                raise InputError(
                    f"settings: found some of {name!r}, expected only those of the predictor, "
                    f"proposer, tracker, encoder, codes and lifting, which are {names}"
                )
        for kind, choice in zip(KINDS, choices, strict=True):
            build[kind] = configure(kind, choice, settings).pin()
        super().__init__(**build)

    @property
    def components(self) -> tuple[ComponentConfig, ...]:
        """The components, in the order in which they are used."""
        return tuple(getattr(self, kind) for kind in KINDS)

    def identity(self) -> dict[str, Any]:
        """Return all inputs of a field except the sample, for cache keys and artifacts.

        The name of each component by kind, the fields of :class:`BuildConfig`, and the fields of
        each component by its name, files by digest.
        """
        named = {component.kind: component.name for component in self.components}
        tables = {component.name: component.identity() for component in self.components}
        used = {name: fields for name, fields in tables.items() if fields}
        return {**named, **dict(BuildConfig.of(self)), **used}

    def check(self) -> None:
        """Load every component once, to detect errors before the work.

        Raises:
            InputError: If a value is out of bounds, or files are invalid.
        """
        for component in self.components:
            component.load()
