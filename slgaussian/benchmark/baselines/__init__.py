"""Registry of the methods that a benchmark compares.

A name that ends in "like" is not the original: it reimplements the main idea on the same
photographs, Gaussians and encoder as the other methods. docs/reference/methods.md describes each
method and its differences from the original.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import plugin_identity, plugins, resolve
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.benchmark.answering import Answering
    from slgaussian.benchmark.baselines.inputs import Inputs

METHODS = {
    "slgaussian": "slgaussian.benchmark.baselines.ours:Ours",
    "query-2d": "slgaussian.benchmark.baselines.query_2d:Query2d",
    "langsplat-like": "slgaussian.benchmark.baselines.langsplat_like:LangSplatLike",
    "no-association": "slgaussian.benchmark.baselines.ours:NoAssociation",
    "no-bank": "slgaussian.benchmark.baselines.ours:NoBank",
}

GROUP = "slgaussian.methods"
"""Entry-point group of methods from other packages."""


class Baseline(Protocol):
    """A method: a callable that prepares a scene for answering texts."""

    def __call__(self, inputs: Inputs) -> Answering:
        """Prepare the scene; InputError if the encoder or the proposer is not suitable."""


def load_method(name: str, **settings: Any) -> Baseline:
    """Make the method ``name``.

    Raises:
        InputError: If the method or a setting does not exist, or a setting is out of range.
    """
    method = resolve("method", METHODS, name, GROUP)
    try:
        return method(**settings)
    except TypeError as error:
        raise InputError(f"settings of {name!r}: {error}") from None


@dataclass(frozen=True)
class Row:
    """A row of the table of methods: one of :data:`METHODS` with settings.

    ``about`` describes it in a line. ``rules`` override the fields of the run's
    :class:`slgaussian.language.rules.Rules`. A ``variant`` is the field with one component changed.
    """

    method: str
    about: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    rules: Mapping[str, Any] = field(default_factory=dict)
    variant: bool = False

    def load(self) -> Baseline:
        """Make the method; raises as :func:`load_method`."""
        return load_method(self.method, **self.settings)

    @property
    def package_identity(self) -> str:
        """Return the identity of the package of an external method; empty for our methods."""
        return "" if self.method in METHODS else plugin_identity(GROUP, self.method)


ROWS = {
    "slgaussian": Row("slgaussian", "the field, as it was built"),
    "query-2d": Row(
        "query-2d", "the paper's 2D query: render, propose, encode, score; the image alone"
    ),
    "query-2d, depth": Row(
        "query-2d",
        "the same, with the rendered depth and groups of objects, as the field sees photographs",
        {"depth": True},
    ),
    "langsplat-like": Row(
        "langsplat-like",
        "not LangSplat: an autoencoder's codes by each view's own masks, on Gaussians that were "
        "predicted",
    ),
    "langsplat-like, association": Row(
        "langsplat-like",
        "not LangSplat: the same, by masks that agree across views",
        {"association": True},
    ),
    "no-association": Row(
        "no-association", "ablation: each view's masks are objects of their own", variant=True
    ),
    "no-bank": Row(
        "no-bank", "ablation: the mean over views in place of the multi-view bank", variant=True
    ),
    "absent-zero": Row(
        "slgaussian",
        "ablation: the paper's zero vector for an absent view",
        rules={"absent": "zero"},
        variant=True,
    ),
}
ROWS |= {name: Row(name, "of another package") for name in plugins(GROUP) if name not in ROWS}
"""All methods, in the order of the table."""


def is_variant(name: str) -> bool:
    """Tell whether a method is the field with a component, or with settings FIELD=VALUE changed."""
    return ROWS[name].variant if name in ROWS else "=" in name
