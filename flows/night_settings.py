"""Settings of a night: what retraining asks for, and who is told of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ConfigDict, Field

from flows.corpus_settings import check_bounds
from flows.settings import checked, read_values, refuse_idle
from flows.training_settings import RetrainSettings

STATUS = {
    "promoted": 0,
    "left out": 1,
    "failed": 2,
    "refused": 3,
    "regressed": 4,
    "busy": 5,
    "nothing new": 6,
}
"""Exit status of the command by what came of the night."""


class NightSettings(RetrainSettings):
    """A retraining that nobody watches."""

    model_config = ConfigDict(title="The night")

    notify: str | None = Field(
        None,
        description="Command or HTTP address that is told what came of it, as JSON.",
    )


def read_night(config: Path, given: dict[str, Any]) -> NightSettings:
    """The settings in a TOML file, over which those ``given`` to hand win.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown or missing, or a value does not fit.
    """
    settings = checked(NightSettings, read_values(config, given), str(config))
    refuse_idle(given, settings, "nightly")
    check_bounds(settings, str(config))
    return settings
