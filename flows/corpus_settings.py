"""Settings of the flows that make a corpus of chunks ready to learn from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from flows.settings import SIDES, Engine, Method, checked, refuse_idle, sides
from slgaussian.datasets import FROM_FILES
from slgaussian.errors import InputError
from slgaussian.formats.text import read_lines


def _parse_sides(value: Any) -> tuple[int, int]:
    found = sides(value)
    if found is None:
        raise PydanticCustomError(
            "size",
            f"expected height and width as in 256x256, each from {SIDES[0]} to {SIDES[-1]}",
        )
    return found


Sides = Annotated[tuple[int, int], BeforeValidator(_parse_sides)]


class PackSettings(BaseModel):
    """How made-up rooms are photographed, and how large chunks are."""

    model_config = ConfigDict(title="The clips", extra="forbid", frozen=True, allow_inf_nan=False)

    views: int = Field(12, ge=2, description="Views of each made-up room, evenly on an arc.")
    baseline: float = Field(
        1.2, gt=0, description="Metres between the first and the last; the middle is 3.3 m away."
    )
    size: Sides = Field((360, 640), description="Their height and width, as 360x640.")
    chunk_mb: float = Field(
        100.0, gt=0, description="Megabytes of images after which a chunk is closed."
    )


BOUNDS = {
    "min_overlap", "max_overlap", "min_baseline", "max_baseline", "max_blur", "max_clipped", "most",
}  # fmt: skip
"""The settings that are fields of :class:`slgaussian.datasets.pair_selection.Bounds`, which is not
imported here as it takes OpenCV with it."""


class PairSettings(BaseModel):
    """What is asked of two context views."""

    model_config = ConfigDict(
        title="Which context views are taken", extra="forbid", frozen=True, allow_inf_nan=False
    )

    min_overlap: float = Field(
        0.6, ge=0, le=1, description="Least share that context views see in common."
    )
    max_overlap: float = Field(
        1.0, ge=0, le=1, description="Greatest share that they see in common."
    )
    min_baseline: float = Field(
        0.08,
        ge=0,
        description="Least distance of context cameras, as a share of the depth of what they see.",
    )
    max_baseline: float = Field(
        0.4, ge=0, description="Greatest distance of context cameras, likewise."
    )
    max_blur: float = Field(
        0.16,
        ge=0,
        description="By how much a view may be more blurred than the median of its clip, 0 to 1.",
    )
    max_clipped: float = Field(
        0.4, ge=0, le=1, description="Share of a view that may be black or white."
    )

    def bounds(self) -> dict[str, Any]:
        """Return the fields of :class:`slgaussian.datasets.pair_selection.Bounds`."""
        return self.model_dump(include=BOUNDS)


class IndexSettings(PairSettings):
    """By which rule the index of a labelled set is made."""

    model_config = ConfigDict(title="Which context views are taken")

    format: str = Field(
        "nerfstudio",
        examples=list(FROM_FILES),
        description="Of the data, such as lerf_ovs or ovs3d.",
    )
    min_cover: float = Field(
        0.9, ge=0, le=1, description="Least share of a labelled frame that a context view sees."
    )
    max_aside: float = Field(
        0.3,
        ge=0,
        lt=0.5,
        description="Greatest distance of a labelled frame from the middle of the context cameras, "
        "as a share of their distance.",
    )


class Withdrawal(BaseModel):
    """What must not be used any more."""

    model_config = ConfigDict(title="The clips", extra="forbid", frozen=True, allow_inf_nan=False)

    withdrawn: Path | None = Field(
        None,
        description="File with the keys of clips that may not be used any more, a line each.",
    )

    def withdrawn_clips(self) -> set[str]:
        """The keys in the file; InputError if it cannot be read."""
        if self.withdrawn is None:
            return set()
        try:
            lines = read_lines(self.withdrawn)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"withdrawn {self.withdrawn}: cannot be read ({error}); expected keys of clips, a "
                "line each"
            ) from error
        return {line.strip() for line in lines if line.strip()}


class CorpusSettings(Withdrawal, PairSettings, Engine, Method):
    """What views, samples and lessons depend on, and where they go."""

    model_config = ConfigDict(title="The corpus")

    size: Sides = Field(
        (256, 256), description="Height and width of the views of a lesson, as 256x256."
    )
    most: int = Field(0, ge=0, description="Most samples of a clip; 0 for as many as there are.")
    chunks: str = Field(description="Folder or fsspec URL of the chunks.")
    out: Path = Field(description="Folder for the tables and contact sheets.")


def make_corpus_settings(values: dict[str, Any], source: str) -> CorpusSettings:
    """Check ``values``; InputError in one sentence, naming ``source``, the key and what fits.

    The folder of chunks must be there: this is said before a store or a server is begun for it.
    """
    settings = checked(CorpusSettings, values, source)
    refuse_idle(values, settings, source)
    check_bounds(settings, source)
    if "://" not in settings.chunks and not Path(settings.chunks).is_dir():
        raise InputError(
            f"{source}: {settings.chunks}: is no folder; expected one of chunks, or its fsspec URL"
        )
    return settings


def check_bounds(settings: PairSettings, source: str) -> None:
    """InputError if no pair can fit."""
    for name in ("overlap", "baseline"):
        low, high = getattr(settings, f"min_{name}"), getattr(settings, f"max_{name}")
        if low > high:
            raise InputError(
                f"{source}: min_{name} {low:g} is above max_{name} {high:g}; no pair can fit"
            )
