"""Settings of the sweep that weighs settings against each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, Field

from flows.settings import TABLES, MethodSettings, Settings, checked, make_settings

WANTED = ("seconds", "memory", "error", "seeds")
"""The settings of the sweep itself."""

METHOD = {"preset", *MethodSettings.model_fields, *TABLES}
"""The settings over which it goes."""


class TradeoffSettings(Settings):
    """A run whose settings are changed one at a time, and what is wanted of the best."""

    model_config = ConfigDict(title="What is wanted")

    seconds: float | None = Field(
        None, gt=0, description="Propose what builds and answers in so many seconds."
    )
    memory: float | None = Field(None, gt=0, description="Propose what takes at most so many MB.")
    error: float | None = Field(
        None, gt=0, lt=1, description="Propose the quickest with at most this error, 0 to 1."
    )
    seeds: int = Field(2, ge=0, description="Rows that change the seed alone: the noise.")
    given: dict[str, Any] = Field({}, description="What is set of the method.")


def make_tradeoff_settings(values: Mapping[str, Any]) -> TradeoffSettings:
    """Check what was given to the command; InputError in one sentence."""
    own = {name: values[name] for name in WANTED if name in values}
    run = {name: value for name, value in values.items() if name not in WANTED}
    known = make_settings(run, "tradeoffs").model_dump()
    given = {name: value for name, value in run.items() if name in METHOD}
    # Seconds are those of the whole machine: one scene at a time.
    alone = {"runner": "threads", "workers": 1}
    return checked(TradeoffSettings, {**known, **alone, **own, "given": given}, "tradeoffs")
