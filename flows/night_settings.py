"""Settings of a night: what retraining asks for, and a training set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import ConfigDict, Field

from flows.corpus_settings import check_bounds
from flows.dataset_settings import DatasetSettings, SetSettings
from flows.settings import checked, read_values, refuse_idle, settled
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


class NightSet(SetSettings):
    """A training set that each night brings up to date with the corpus."""

    model_config = ConfigDict(title="The training set")

    out: Path = Field(description="Folder of the training set.")


class NightSettings(RetrainSettings):
    """A retraining that nobody watches."""

    model_config = ConfigDict(title="The night")

    training_set: NightSet | None = Field(
        None, description="Table with `out` and settings of `dataset`: a set of the same clips."
    )

    def set_settings(self, asked: NightSet) -> DatasetSettings:
        """What `dataset` is asked for: the corpus and method of the night, into a folder apart."""
        own = DatasetSettings.model_fields.keys() & self.model_fields_set
        common = {name: getattr(self, name) for name in own}
        return settled(DatasetSettings(**{**common, **dict(asked), "sources": [self.chunks]}))


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
