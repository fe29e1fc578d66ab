"""The settings that trade accuracy for time, each as the options that make it.

One setting is changed at a time from those that the user gave, then a few together, and the
presets. What a changed setting does not touch is found in the store.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from flows.settings import TABLES, Settings, make_settings
from slgaussian.errors import InputError

GIVEN, SEED = "as given", "seed"
"""The factors of the row that all others are compared with, and of those that show the noise."""

SMALL, MIDDLE, LARGE = (f"at most {size}" for size in ("208x288", "312x432", "624x864"))
CANDIDATES = "depth_candidates"
TOGETHER: tuple[tuple[str, int | None], ...] = (
    (SMALL, 32),
    (SMALL, 64),
    (MIDDLE, None),
    (LARGE, 216),
)
"""Sizes and depth candidates that are also tried together, without codes."""


@dataclass(frozen=True)
class Variant:
    """A row of the sweep: what is changed, in words, and all settings that are not the defaults."""

    factor: str
    name: str
    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def options(self) -> str:
        """The options of a command that make it, as they can be pasted."""
        words = []
        for key, value in self.values.items():
            if key in TABLES:
                words += [word for k, v in value.items() for word in (_option(key, k), str(v))]
            else:
                words += [_option(key), str(value)]
        return shlex.join(words)


def _option(*path: str) -> str:
    return f"--{'-'.join(path).replace('_', '-')}"


def _changes() -> Iterator[Variant]:
    """All that is tried, from the defaults."""
    for size in (SMALL, MIDDLE, LARGE):
        yield Variant("size", size, {"size": size})
    for most in (32, 64, 216):
        own = {"planesweep": {CANDIDATES: most}}
        yield Variant("depth candidates", f"at most {most}", own)
    yield Variant("Gaussians", "all", {"keep": "all"})
    yield Variant("replicas", "1", {"replicas": 1})
    yield Variant("tracker", "flow", {"tracker": "flow"})
    for codes in ("exact", "grid"):
        yield Variant("codes", codes, {"codes": codes})
    yield Variant("lifting", "filled", {"lifting": "filled"})
    yield Variant("bank", "objects", {"bank": "objects"})
    for preset in ("fast", "paper"):
        yield Variant("preset", preset, {"preset": preset})
    for size, depths in TOGETHER:
        both = {} if depths is None else {"planesweep": {CANDIDATES: depths}}
        told = f"{size}, exact" + ("" if depths is None else f", {depths} depths")
        yield Variant("together", told, {"size": size, "codes": "exact", **both})


def variants(given: Mapping[str, Any], seeds: int) -> list[tuple[Variant, Settings]]:
    """What is tried on top of the settings that were given, those themselves first.

    ``seeds`` more rows change the seed alone. What is the same as an earlier row, or does not go
    with what was given, is left out.

    Raises
    ------
    InputError
        If what was given is wrong.
    """
    first = make_settings(dict(given), "tradeoffs")
    found = [(Variant(GIVEN, GIVEN, given), first)]
    known = [_built(first)]
    noise = (
        Variant(SEED, str(first.seed + k), {"seed": first.seed + k}) for k in range(1, seeds + 1)
    )
    for one in (*_changes(), *noise):
        try:
            values = _over(given, one.values)
            settings = make_settings(values, "tradeoffs")
        except InputError:  # as the depths of a predictor that was not chosen
            continue
        if (built := _built(settings)) not in known:
            known.append(built)
            found.append((Variant(one.factor, one.name, values), settings))
    return found


def _over(given: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(given)
    for key, value in values.items():
        merged[key] = {**merged.get(key, {}), **value} if key in TABLES else value
    return merged


def _built(settings: Settings) -> tuple[Any, ...]:
    """What answers depend on."""
    return settings.size, repr(settings.identity), tuple(sorted(settings.rules().items(), key=str))
