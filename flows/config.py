"""The configurations of the flows, as pydantic models: each field, its default, bounds and help."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, create_model, model_validator

from flows.forms import PRESETS, RUNNERS, Form, Phrase, Runner, Sides, Size, Widths
from slgaussian.components import method
from slgaussian.components.config import ComponentConfig, Config
from slgaussian.components.method import BuildConfig
from slgaussian.components.registry import KINDS, configure, find_config, list_names
from slgaussian.datasets import FROM_FILES
from slgaussian.datasets.configs import Bounds, Rule
from slgaussian.errors import InputError
from slgaussian.io import read_lines
from slgaussian.kernels import threads
from slgaussian.language.rules import Rules
from slgaussian.semantic.configs import TrainingConfig

RULES = set(Rules.model_fields)
"""Names of the settings of a query."""


def _kind(kind: str) -> Any:
    names = [*list_names(kind)]
    text = f"{KINDS[kind].help.removesuffix('.')}: {', '.join(names[:-1])} or {names[-1]}."
    extra: Any = {"enum": names}
    return Field(KINDS[kind].default, description=text, examples=names, json_schema_extra=extra)


class MethodSettings(Rules, BuildConfig):
    """Components of the method and their settings, on which results depend."""

    size: Size = Field(
        "auto",
        description="Height and width of the views: 416x576, 'at most 416x576' (without "
        "enlarging), original, or auto, which is at most 416x576.",
    )
    near: float | None = Field(
        None,
        gt=0,
        description="Smallest depth, in scene units; estimated from the photographs by default.",
    )
    far: float | None = Field(None, gt=0, description="Largest depth, likewise.")
    predictor: str = _kind("predictor")
    proposer: str = _kind("proposer")
    tracker: str = _kind("tracker")
    encoder: str = _kind("encoder")
    codes: str = _kind("codes")
    lifting: str = _kind("lifting")
    trust_cameras: bool = Field(
        False,
        description="Continue even if the matches between the photographs contradict the cameras.",
    )

    def configure(self, kind: str) -> ComponentConfig:
        """Return the config of the chosen component of a kind; InputError if it is unknown."""
        name = getattr(self, kind)
        table = name.replace("-", "_")
        return configure(kind, getattr(self, table) if table in TABLES else name)

    @cached_property
    def components(self) -> tuple[ComponentConfig, ...]:
        """The configs of the chosen components; InputError if one is unknown."""
        return tuple(map(self.configure, KINDS))

    @cached_property
    def field_method(self) -> method.Method:
        """The method that builds a field; InputError if files cannot be read."""
        components: dict[str, Any] = dict(zip(KINDS, self.components, strict=True))
        return method.Method(**components, **dict(BuildConfig.of(self)))


def _tables() -> dict[str, type[ComponentConfig]]:
    """Return the configs of all registered components with fields, by table name."""
    tables = dict[str, type[ComponentConfig]]()
    for kind in KINDS:
        for name in list_names(kind):
            # Errors are reported when the component is used.
            with suppress(InputError):
                config = find_config(kind, name)
                if config() and config.model_fields:
                    tables.pop(config.table, None)  # of kinds that share one, the last
                    tables[config.table] = config
    return tables


TABLES = _tables()
"""Configs of components, by table name."""

_fields: Any = {table: (config, config()) for table, config in TABLES.items()}
Method = create_model("Method", __base__=MethodSettings, __doc__=MethodSettings.__doc__, **_fields)
"""Settings of the method, with the tables of all components."""


class SceneSettings(Config):
    """One scene: its photographs, context and target views, labels and queries."""

    name: str = Field(min_length=1)
    dataset: str = Field("scenes", min_length=1)
    format: str = "nerfstudio"
    path: Path | None = None
    options: dict[str, Any] = Field({})
    context: list[str] = Field(min_length=2)
    targets: list[str] = Field([])
    size: Size | None = None
    near: float | None = Field(None, gt=0)
    far: float | None = Field(None, gt=0)
    labels: Path | None = None
    categories: list[Phrase] = Field([])
    queries: list[Phrase] = Field([])


def check_names(scenes: Sequence[SceneSettings]) -> None:
    """Raise InputError if two scenes have the same name."""
    for name, count in Counter(scene.name for scene in scenes).items():
        if count > 1:
            raise InputError(f"two scenes are called {name!r}; names must be unique")


class Engine(Form):
    """Runner, workers and store of a flow."""

    store: str = Field(
        "./slg-data", description="Folder or fsspec URL for the results of all stages."
    )
    runner: Runner = Field(
        "threads",
        examples=list(RUNNERS),
        description="Workers: threads, processes, or a running cluster, as dask://host:port.",
    )
    workers: int = Field(
        min(2, threads.cores()), ge=1, description="Number of concurrent scenes (or chunks)."
    )
    max_failures: float = Field(
        0.5,
        ge=0,
        description="Scenes (or chunks) that may be left out before the run stops: a number, or a "
        "share below 1 of those that have ended.",
    )
    refresh: list[str] = Field(
        [], description="Stages to recompute, with all stages that depend on them."
    )
    only_missing: bool = Field(
        False,
        description="Run tasks only for scenes (or chunks) without a complete result in the store.",
    )


class Settings(Engine, Method):
    """Configuration of a run."""

    preset: Literal["fast", "balanced", "paper"] | None = Field(
        None,
        examples=list(PRESETS),
        description=f"Named settings: {', '.join(PRESETS)}; other options override them.",
    )
    out: Path = Field(Path("out"), description="Folder for the report and the tables.")
    method: str = Field("slgaussian", description="Name of the method in tables and folders.")
    data: Path | None = Field(None, description="Folder of a labelled set.")
    format: str | None = Field(
        None,
        examples=list(FROM_FILES),
        description="Format of the data, if the index does not name it; default nerfstudio.",
    )
    pairs: Path | None = Field(
        None, description="Index file of the data, written by `benchmark` or by hand."
    )
    labels: Path | None = Field(
        None,
        description="Labels, a folder or a COCO file, if they are not in the folder of the data.",
    )
    rooms: str | None = Field(
        None, description="Procedural rooms to score as well, by their seeds: FIRST-LAST."
    )
    against: list[str] = Field(
        [], description="Baselines to score in the same run, by name, or all."
    )
    sweep: list[str] = Field(
        [],
        description="Settings to compare in the same run: FIELD=a,b,c, where FIELD is a setting of "
        "the method, views or preset; several are combined.",
    )
    scenes: list[SceneSettings] = Field([], description="More scenes, besides a labelled set.")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        check_names(self.scenes)
        return self


class IndexSettings(Rule):
    """Rule that chooses the context views in the index of a labelled set, and its format."""

    format: str = Field(
        "nerfstudio",
        examples=list(FROM_FILES),
        description="Format of the data, such as lerf_ovs or ovs3d.",
    )


class CorpusSettings(Bounds, Engine, Method):
    """Settings of views, samples and lessons, and their output folder."""

    size: Sides = Field((256, 256), description="Height and width of all views, as 256x256.")
    sources: list[str] = Field(
        min_length=1, description="Chunks (a folder or URL), or folders of any scenes."
    )
    out: Path = Field(description="Folder for the results.")
    withdrawn: Path | None = Field(
        None,
        description="File with the keys of clips that may no longer be used, one per line.",
    )

    def withdrawn_clips(self) -> set[str]:
        """Read the keys in the file; InputError if it cannot be read."""
        try:
            lines = [] if self.withdrawn is None else read_lines(self.withdrawn)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"withdrawn {self.withdrawn}: cannot be read ({error}); expected keys of clips, "
                "one per line"
            ) from error
        return {line.strip() for line in lines if line.strip()}


class DatasetSettings(CorpusSettings):
    """A training set: its sources, the content and format of its samples, its output folder."""

    targets: int = Field(3, ge=1, description="Number of target views, between the context views.")
    held_out: float = Field(
        0.2, ge=0, lt=1, description="Approximate fraction of the places in the split test."
    )
    images: Literal["jpg", "png"] = Field(
        "jpg",
        examples=["jpg", "png"],
        description="Format of stored images: jpg (quality 95) or png.",
    )
    shard_mb: float = Field(100.0, gt=0, description="Megabytes after which a shard is full.")
    keep_old_days: float = Field(
        7.0,
        ge=0,
        description="Days that a shard stays after it left the index, for readers that are open.",
    )
    licences: dict[str, str] = Field(
        {},
        description="Licence of each source, by its name or location; others are unknown.",
    )


class Training(TrainingConfig):
    """Hyperparameters of a training, without lessons, codes and seed."""

    held_out: float = Field(
        0.2, gt=0, lt=1, description="Approximate fraction of the clips held out for evaluation."
    )
    widths: Widths | None = Field(
        None,
        description="Channels of the branch at full resolution, half, a quarter ...; default: "
        "those of the initial weights, else 16,32,64,64.",
    )
    hidden: int | None = Field(
        None, ge=1, description="Width of the hidden layer for each pixel; likewise, else 64."
    )


_SHARED: dict[str, Any] = dict(CorpusSettings.model_fields)
"""Fields of other commands."""


class TrainSettings(Form, Training):
    """Training on existing lessons."""

    preset_prefix = "train_"

    preset: Literal["paper"] | None = Field(
        None,
        examples=["paper"],
        description="Named settings: paper, those of its training; other options override them.",
    )
    codes: str = _SHARED["codes"]
    seed: int = _SHARED["seed"]
    store: str = _SHARED["store"]
    lessons: Path = Field(description="Output folder of `supervise`.")
    start: Path | None = Field(
        None, description="Initial weights: a file, or a folder of versions."
    )
    out: Path = Field(description="Folder for the weights and the report.")


class RetrainSettings(Training, CorpusSettings):
    """Retraining on a growing corpus."""

    models: Path = Field(description="Folder of the versions of the weights.")


_GROUPS: dict[str, Sequence[str]] = {
    "Run": ("sources", "lessons", "data", "scenes", "rooms", "out", "preset", "models", "start",
            "against", "sweep", "method", "format", "pairs", "labels", "targets", "images",
            "shard_mb", "held_out", "withdrawn", "licences", "keep_old_days"),
    "Samples": tuple(Bounds.model_fields),
    "Training": (*TrainingConfig.model_fields, "widths", "hidden"),
    "Method": ("size", "near", "far", "trust_cameras", *BuildConfig.model_fields),
    "Answers": tuple(Rules.model_fields),
    "Components": (*KINDS, *TABLES),
    "Engine": tuple(Engine.model_fields),
}  # fmt: skip
Form.titles = {key: f"{group}: {key}" for group, keys in _GROUPS.items() for key in keys}
