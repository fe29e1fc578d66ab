"""The configurations of the flows, as pydantic models: each field, its default, bounds and help."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from slgaussian.components.component import Component
from slgaussian.components.config import ComponentConfig
from slgaussian.components.method import BANK, KEEP, METHOD_FIELDS, VOTES
from slgaussian.components.method import Method as BuildMethod
from slgaussian.components.registry import KINDS, find_config, plugins
from slgaussian.datasets import FROM_FILES
from slgaussian.errors import InputError, did_you_mean
from slgaussian.formats.text import read_lines
from slgaussian.kernels import threads
from slgaussian.language.configs import ClipConfig, GridConfig, LexiconConfig, SeparatedConfig
from slgaussian.masks.configs import PrecomputedConfig, Sam2Config, Sam2VideoConfig, SamConfig
from slgaussian.predict.configs import MVSplatConfig, PlaneSweepConfig
from slgaussian.semantic.configs import BranchConfig

PRESETS = ("fast", "balanced", "paper")
"""Named settings, each a file in `presets`. The last is what the paper prints, see
`docs/reference/paper.md`."""

SIDES = range(16, 8193)
"""Heights and widths, in pixels, that views may be brought to."""


def _parse_sides(value: Any) -> tuple[int, int]:
    """Height and width of ``"256x256"``, as the command line gives them, or of a pair."""
    try:
        height, width = map(int, value.split("x") if isinstance(value, str) else value)
    except (TypeError, ValueError):
        height = width = 0
    if height not in SIDES or width not in SIDES:
        raise PydanticCustomError(
            "size",
            f"expected height and width as in 256x256, each from {SIDES[0]} to {SIDES[-1]}",
        )
    return height, width


AT_MOST = "at most "


def _parse_size(value: Any) -> tuple[int, int] | str:
    """Height and width, or words."""
    if value in ("auto", "original"):
        return value
    bound = isinstance(value, str) and value.startswith(AT_MOST)
    try:
        sides = _parse_sides(value.removeprefix(AT_MOST) if bound else value)
    except PydanticCustomError as error:
        message = f"{error.message()}, 'at most 416x576', 'auto' or 'original'"
        raise PydanticCustomError("size", message) from None
    return "{}{}x{}".format(AT_MOST, *sides) if bound else sides


Sides = Annotated[tuple[int, int], BeforeValidator(_parse_sides)]
Size = Annotated[tuple[int, int] | str, BeforeValidator(_parse_size)]
Phrase = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


RUNNERS = ("threads", "processes")
"""Who may do the work of a flow on this machine."""
CLUSTERS = ("dask", "ray")
"""Whose workers may, by the address of a cluster that runs."""


def _parse_runner(value: Any) -> str:
    kind, _, address = str(value).partition("://")
    host, _, port = address.rpartition(":")
    has_scheme = "://" in str(value)
    if kind in (CLUSTERS if has_scheme else RUNNERS) and (
        not has_scheme or (host and port.isdecimal())
    ):
        return str(value)
    raise PydanticCustomError(
        "runner",
        "expected threads, processes, or for a cluster that runs dask://host:port or "
        f"ray://host:port{did_you_mean(kind, (*RUNNERS, *CLUSTERS))}",
    )


Runner = Annotated[str, BeforeValidator(_parse_runner)]


class Config(BaseModel):
    """Fields that are checked when they are given, and never changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def table_of(component: str) -> str:
    """Return the name of a component's table, for which TOML and Python take no hyphen."""
    return component.replace("-", "_")


class QueryRules(Config):
    """Rules of answering queries."""

    threshold: float | None = Field(
        None,
        gt=0,
        lt=1,
        description="Take what fits a text above this relevancy, 0 to 1.",
    )
    share: float = Field(
        0.6,
        gt=0,
        le=1,
        description="Without a threshold: objects that have this share of the best "
        "one's lead over the canonical phrases fit about as well.",
    )
    temperature: float = Field(10.0, gt=0, description="Temperature of the relevancy.")
    canonical: str | None = Field(
        None,
        description="Phrases that a text competes with, with commas between, or lerf for LERF's "
        "four; the encoder's own if left out.",
    )
    absent: str = Field(
        "skip",
        examples=["skip", "zero"],
        description="What a view says of an object that it does not hold: skip (nothing), or zero "
        "(as the paper).",
    )


RULES = set(QueryRules.model_fields)
"""The settings of a query."""


def _kind(kind: str) -> Any:
    return Field(KINDS[kind].default, description=KINDS[kind].help)


class MethodSettings(QueryRules):
    """The parts of the method and their settings: what a result depends on."""

    size: Size = Field(
        "auto",
        description="Height and width to work at: 416x576, 'at most 416x576' (smaller views stay), "
        "original, or auto, which is at most 416x576.",
    )
    near: float | None = Field(
        None,
        gt=0,
        description="Least depth, in scene units; found from the photographs if left out.",
    )
    far: float | None = Field(None, gt=0, description="Greatest depth, likewise.")
    predictor: str = _kind("predictor")
    proposer: str = _kind("proposer")
    tracker: str = _kind("tracker")
    encoder: str = _kind("encoder")
    codes: str = _kind("codes")
    lifting: str = _kind("lifting")
    trust_cameras: bool = Field(
        False,
        description="Go on even if the matches between the photographs contradict their cameras.",
    )
    replicas: int = Field(5, ge=1, description="Copies of each view that vote on its labels.")
    votes: Literal["views", "copies"] = Field(
        "views",
        examples=list(VOTES),
        description="Who votes on labels: views (copies that differ, then all views on what is one "
        "object), or copies (all of each view, as the paper).",
    )
    seed: int = Field(0, ge=0, description="Seed of everything random.")
    keep: Literal["needed", "all"] = Field(
        "needed",
        examples=list(KEEP),
        description="Gaussians of a field: needed, where even neighbours become larger ones, or "
        "all that were predicted.",
    )
    bank: Literal["groups", "objects"] = Field(
        "groups",
        examples=list(BANK),
        description="What a text is scored on: objects and groups of them, or objects alone (as "
        "the paper).",
    )
    planesweep: PlaneSweepConfig = PlaneSweepConfig()
    mvsplat: MVSplatConfig = MVSplatConfig()
    sam: SamConfig = SamConfig()
    sam2: Sam2Config = Sam2Config()
    sam2_video: Sam2VideoConfig = Sam2VideoConfig()
    precomputed: PrecomputedConfig = PrecomputedConfig()
    lexicon: LexiconConfig = LexiconConfig()
    clip: ClipConfig = ClipConfig()
    grid: GridConfig = GridConfig()
    separated: SeparatedConfig = SeparatedConfig()
    branch: BranchConfig = BranchConfig()

    def component_names(self) -> dict[str, str]:
        """The name of each part."""
        return self.model_dump(include=set(KINDS))

    def component_values(self) -> dict[str, dict[str, Any]]:
        """The tables of the parts that are chosen, as :mod:`slgaussian.build` takes settings."""
        return {
            name: dict(getattr(self, table_of(name)))
            for name in self.component_names().values()
            if table_of(name) in TABLES
        }

    def rules(self) -> dict[str, Any]:
        """Return the fields of :class:`slgaussian.language.rules.Rules`."""
        return self.model_dump(include=RULES)

    def part(self, kind: str) -> Component:
        """The part of a kind, with its settings; InputError if its files cannot be read."""
        name = getattr(self, kind)
        return Component.of(kind, name, self.component_values().get(name))

    @cached_property
    def built_by(self) -> BuildMethod:
        """Method of building a field; InputError if files cannot be read."""
        parts: dict[str, Any] = {kind: self.part(kind) for kind in KINDS}
        return BuildMethod(**parts, **self.model_dump(include=set(METHOD_FIELDS)))

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Identity of a field besides the sample, as cache keys and artifacts hold it.

        The chosen parts, their settings with files by content, replicas, seed and what is kept.
        """
        return self.built_by.identity()


def _brought() -> Iterator[tuple[str, Any]]:
    """Yield table and default config of each component that another package brings."""
    for kind, registered in KINDS.items():
        for name in plugins(registered.group):
            # What is wrong with one is said when it is asked for.
            with suppress(InputError):
                config = find_config(kind, name)
                if config.model_fields:
                    yield table_of(name), (config, config())


Method = create_model(
    "Method", __base__=MethodSettings, __doc__=MethodSettings.__doc__, **dict(_brought())
)
"""The parts of the method, and a table of fields for each that has some."""

TABLES: dict[str, type[ComponentConfig]] = {
    name: field.annotation
    for name, field in Method.model_fields.items()
    if isinstance(field.annotation, type) and issubclass(field.annotation, ComponentConfig)
}
"""The settings that are the config of a component, by its name."""


class SceneSettings(Config):
    """One scene: where its photographs are and which of them are what."""

    name: str = Field(min_length=1)
    dataset: str = Field("scenes", min_length=1)
    format: str = "nerfstudio"
    path: Path | None = None
    options: dict[str, Any] = {}
    context: list[str] = Field(min_length=2)
    targets: list[str] = []
    size: Size | None = None
    near: float | None = Field(None, gt=0)
    far: float | None = Field(None, gt=0)
    labels: Path | None = None
    categories: list[Phrase] = []
    queries: list[Phrase] = []


class Engine(Config):
    """Runner, workers and store of a flow."""

    store: str = Field(
        "./slg-data", description="Folder or fsspec URL that keeps the results of every stage."
    )
    runner: Runner = Field(
        "threads",
        examples=list(RUNNERS),
        description="Who does the work: threads, processes, or a cluster that runs, as "
        "dask://host:port.",
    )
    workers: int = Field(
        min(2, threads.cores()), ge=1, description="Scenes (or chunks) done at a time."
    )
    refresh: list[str] = Field(
        [], description="Stages to compute anew, with what follows from them."
    )


class Settings(Engine, Method):
    """A whole run."""

    preset: str | None = Field(
        None,
        examples=list(PRESETS),
        description=f"Begin from named settings: {', '.join(PRESETS)}; other options win.",
    )
    out: Path = Field(Path("out"), description="Folder for the report and the tables.")
    method: str = Field("slgaussian", description="Name of the method in tables and folders.")
    data: Path | None = Field(None, description="Folder of a labelled set, as its format has it.")
    format: str | None = Field(
        None,
        examples=list(FROM_FILES),
        description="Its format, if the index does not say: nerfstudio if left out.",
    )
    pairs: Path | None = Field(
        None, description="Its index: what `benchmark` wrote, or made by hand."
    )
    labels: Path | None = Field(
        None, description="Folder of its labels, if they are not in that of the data."
    )
    rooms: str | None = Field(
        None, description="Made-up rooms to score as well, by their seeds: FIRST-LAST."
    )
    against: list[str] = Field(
        [], description="Other methods to score in the same run, by name, or all."
    )
    sweep: list[str] = Field(
        [],
        description="Settings to compare in the same run: FIELD=a,b,c, of the method's settings, "
        "views or preset; several are combined.",
    )
    scenes: list[SceneSettings] = Field([], description="More scenes, beside a labelled set.")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [scene.name for scene in self.scenes]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two scenes are called {name!r}; names must be unique")
        return self


class PackSettings(Config):
    """Views of procedural rooms, and size of chunks."""

    views: int = Field(12, ge=2, description="Views of each made-up room, evenly on an arc.")
    baseline: float = Field(
        1.2, gt=0, description="Metres between the first and the last; the middle is 3.3 m away."
    )
    size: Sides = Field((360, 640), description="Their height and width, as 360x640.")
    chunk_mb: float = Field(
        100.0, gt=0, description="Megabytes of images after which a chunk is closed."
    )


class PairSettings(Config):
    """Requirements on two context views."""

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

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        for name in ("overlap", "baseline"):
            low, high = getattr(self, f"min_{name}"), getattr(self, f"max_{name}")
            if low > high:
                raise InputError(
                    f"min_{name} {low:g} is above max_{name} {high:g}; no pair can fit"
                )
        return self

    def bounds(self) -> dict[str, Any]:
        """Return the fields of :class:`slgaussian.datasets.pair_selection.Bounds`.

        That is not imported here, as it takes OpenCV with it.
        """
        return self.model_dump(include={*PairSettings.model_fields, "most"})


class IndexSettings(PairSettings):
    """By which rule the index of a labelled set is made."""

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


class Withdrawal(Config):
    """Clips that may not be used any more."""

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
    """Settings of views, samples and lessons, and their output folder."""

    size: Sides = Field(
        (256, 256), description="Height and width of the views of a lesson, as 256x256."
    )
    most: int = Field(0, ge=0, description="Most samples of a clip; 0 for as many as there are.")
    chunks: str = Field(description="Folder or fsspec URL of the chunks.")
    out: Path = Field(description="Folder for the tables.")


class SetSettings(Config):
    """Content, quality thresholds and format of the samples of a training set."""

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
    shard_mb: float = Field(100.0, gt=0, description="Megabytes after which a shard is closed.")


class DatasetSettings(SetSettings, Withdrawal, PairSettings, Engine, Method):
    """A training set, what it is made from, and where it goes."""

    size: Sides = SetSettings.model_fields["size"]  # type: ignore[assignment]  # not the method's
    sources: list[str] = Field(min_length=1, description="What its clips are from.")
    out: Path = Field(description="Folder of the training set.")


def _parse_widths(value: Any) -> tuple[int, ...]:
    """Channels of a list, or of text with commas between."""
    try:
        widths = tuple(map(int, value.split(",") if isinstance(value, str) else value))
    except (TypeError, ValueError):
        widths = ()
    if not widths or min(widths) < 1:
        raise PydanticCustomError("widths", "expected numbers from 1, as 8,16,24,32")
    return widths


Widths = Annotated[tuple[int, ...], BeforeValidator(_parse_widths)]


class Training(Config):
    """Hyperparameters of a training, without lessons, codes and seed."""

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

    preset: Literal["paper"] | None = Field(
        None,
        examples=["paper"],
        description="Begin from named settings: paper, as it prints its training; other options "
        "win.",
    )
    codes: str = Field(
        "separated",
        examples=["separated", "grid"],
        description="How ID codes are drawn: separated or grid.",
    )
    architecture: Literal["several", "paper"] = Field(
        "several",
        examples=["several", "paper"],
        description="The network and its loss: several, which sees what other views say of a "
        "pixel, or paper, as printed.",
    )
    seed: int = _METHOD["seed"]
    store: str = _CORPUS["store"]
    lessons: Path = Field(description="Folder that `supervise` wrote.")
    start: Path | None = Field(
        None, description="Weights to begin from: a file, or a folder of versions."
    )
    out: Path = Field(description="Folder for the weights and the report.")


class RetrainSettings(Training, CorpusSettings):
    """A corpus that grows, and the weights that are kept of it."""

    models: Path = Field(description="Folder of the versions of the weights.")
