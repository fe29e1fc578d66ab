"""Settings of the flows that train the semantic branch, once or whenever there is something new."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from flows.corpus_settings import CorpusSettings, check_bounds
from flows.dataset_settings import DatasetSettings, SetSettings
from flows.settings import Method, anchored, checked, read_values, refuse_idle, settled


def _parse_widths(value: Any) -> tuple[int, ...]:
    """Channels of a list, or of text with commas between."""
    try:
        found = tuple(map(int, value.split(",") if isinstance(value, str) else value))
    except (TypeError, ValueError):
        found = ()
    if not found or min(found) < 1:
        raise PydanticCustomError("widths", "expected numbers from 1, as 8,16,24,32")
    return found


Widths = Annotated[tuple[int, ...], BeforeValidator(_parse_widths)]


class Training(BaseModel):
    """What a training is besides its lessons, codes and seed."""

    model_config = ConfigDict(
        title="The training", extra="forbid", frozen=True, allow_inf_nan=False
    )

    steps: int = Field(1500, ge=1, description="Steps of training.")
    batch: int = Field(1, ge=1, description="Lessons of a step.")
    rate: float = Field(3e-3, gt=0, description="Highest learning rate.")
    corrupted: float = Field(
        0.75, ge=0, le=1, description="Share of the steps with corrupted labels."
    )
    held_out: float = Field(
        0.2, gt=0, lt=1, description="Share of the clips, about, that are kept to judge by."
    )
    widths: Widths | None = Field(
        None,
        description="Channels of the branch at full size, half, a quarter ...; if left out, those "
        "of the weights to begin from, else 8,16,24,32.",
    )
    hidden: int | None = Field(
        None, ge=1, description="Numbers of the hidden layer for each pixel; likewise, else 32."
    )
    device: str = Field(
        "cpu",
        description="Where the network computes, as PyTorch calls it: cpu; cuda and others go the "
        "same way and have not been tried.",
    )
    threads: int = Field(
        1, ge=1, description="Threads of PyTorch; on their number depend the last bits."
    )


# Settings that are those of other commands, declared there.
_METHOD: dict[str, Any] = dict(Method.model_fields)
_CORPUS: dict[str, Any] = dict(CorpusSettings.model_fields)


class TrainSettings(Training):
    """A training on lessons that are there already."""

    model_config = ConfigDict(title="The training")

    codes: str = Field(
        "separated",
        examples=["separated", "grid"],
        description="How ID codes are drawn: separated or grid.",
    )
    architecture: Literal["several", "paper"] = Field(
        "several",
        examples=["several", "paper"],
        description="What a branch sees of a pixel: what several views say of it, or its own view "
        "alone (as the paper).",
    )
    seed: int = _METHOD["seed"]
    store: str = _CORPUS["store"]
    lessons: Path = Field(
        description="Folder that `supervise` wrote, or `dataset` with --gaussians."
    )
    start: Path | None = Field(
        None, description="Weights to begin from: a file, or a folder of versions."
    )
    out: Path = Field(description="Folder for the weights and the report.")


class GrowingSet(SetSettings):
    """A training set that each retraining brings up to date with the corpus."""

    model_config = ConfigDict(title="The training set")

    out: Path = Field(description="Folder of the training set.")


class RetrainSettings(Training, CorpusSettings):
    """A corpus that grows, and the weights that are kept of it."""

    model_config = ConfigDict(title="The training")

    models: Path = Field(description="Folder of the versions of the weights.")
    training_set: GrowingSet | None = Field(
        None, description="Table with `out` and settings of `dataset`: a set of the same clips."
    )

    def dataset_settings(self, growing: GrowingSet) -> DatasetSettings:
        """Return what `dataset` is asked for: the corpus and method, into a folder of its own."""
        shared = DatasetSettings.model_fields.keys() & self.model_fields_set
        common = {name: getattr(self, name) for name in shared}
        return settled(DatasetSettings(**{**common, **dict(growing), "sources": [self.chunks]}))


def read_retraining(config: Path | None, given: dict[str, Any]) -> RetrainSettings:
    """The settings in a TOML file, over which those ``given`` to hand win.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown or missing, or a value does not fit.
    """
    source = "retrain" if config is None else str(config)
    values = given if config is None else read_values(config, given)
    settings = checked(RetrainSettings, values, source)
    refuse_idle(given, settings, "retrain")
    check_bounds(settings, source)
    return settings


def anchored_config(config: RetrainSettings) -> RetrainSettings:
    """Return a config that means the same in any working folder, with the store that it names."""
    values = config.model_dump(exclude_unset=True) | {"store": config.store}
    return RetrainSettings(**anchored(values, Path.cwd()))
