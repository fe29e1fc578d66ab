"""Settings of the flow that makes a training set."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from flows.corpus_settings import PairSettings, Sides, Withdrawal, check_bounds
from flows.settings import Engine, Method, checked, refuse_idle, settled


class SetSettings(BaseModel):
    """What samples hold, which are good enough, and how they are written."""

    model_config = ConfigDict(
        title="The training set", extra="forbid", frozen=True, allow_inf_nan=False
    )

    size: Sides = Field((256, 256), description="Height and width of all views, as 256x256.")
    targets: int = Field(3, ge=1, description="Target views of a sample, between its two contexts.")
    most: int = Field(0, ge=0, description="Most samples of a clip; 0 for as many as there are.")
    max_unlabelled: float = Field(
        1.0, ge=0, le=1, description="Share of pixels that may be without an object id."
    )
    min_confirmed: float = Field(
        0.0, ge=0, le=1, description="Least share of the depth that a second view confirms."
    )
    held_out: float = Field(
        0.2, ge=0, lt=1, description="Share of the places, about, that go to the split test."
    )
    images: Literal["jpg", "png"] = Field(
        "jpg",
        examples=["jpg", "png"],
        description="How images are stored: jpg (quality 95) or png.",
    )
    gaussians: bool = Field(
        False, description="Store the Gaussians too; without them it is depth alone."
    )
    shard_mb: float = Field(100.0, gt=0, description="Megabytes after which a shard is closed.")


class DatasetSettings(SetSettings, Withdrawal, PairSettings, Engine, Method):
    """A training set, what it is made from, and where it goes."""

    model_config = ConfigDict(title="The training set")

    size: Sides = SetSettings.model_fields["size"]  # type: ignore[assignment]  # not the method's
    sources: list[str] = Field(min_length=1, description="What its clips are from.")
    out: Path = Field(description="Folder of the training set.")


def make_dataset_settings(values: dict[str, Any]) -> DatasetSettings:
    """Check ``values``; InputError in one sentence, naming the key and what fits.

    Sources in a folder must be there: this is said before a store or a server is begun for them.
    """
    from flows.clip_sources import check_there  # reads formats, which `--help` need not

    settings = checked(DatasetSettings, values, "dataset")
    check_there(settings.sources)
    refuse_idle(values, settings, "dataset")
    check_bounds(settings, "dataset")
    return settled(settings)
