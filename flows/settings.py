"""Every setting of a run and its default, from a TOML file or the command line."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    create_model,
)
from pydantic_core import PydanticCustomError

from flows.encoder_choice import AUTO, CANDIDATES, find_clip
from slgaussian.components.component import Component
from slgaussian.components.config import ComponentConfig
from slgaussian.components.method import BANK, KEEP, OWN
from slgaussian.components.method import Method as BuildMethod
from slgaussian.components.registry import KINDS, brought, find_config, names_of
from slgaussian.datasets import FROM_FILES
from slgaussian.errors import InputError, did_you_mean
from slgaussian.kernels import threads
from slgaussian.language.configs import ClipConfig, GridConfig, SeparatedConfig
from slgaussian.masks.configs import PrecomputedConfig, Sam2Config, Sam2VideoConfig, SamConfig
from slgaussian.predict.configs import MVSplatConfig, PlaneSweepConfig
from slgaussian.semantic.configs import BranchConfig
from slgaussian.storage.remote import check_url

SIDES = range(16, 8193)
"""Heights and widths, in pixels, that views may be brought to."""


def sides(value: Any) -> tuple[int, int] | None:
    """Height and width of ``"416x576"``, as the command line gives them, or of a pair.

    None if it is neither, or one is not in :data:`SIDES`.
    """
    try:
        height, width = map(int, value.split("x") if isinstance(value, str) else value)
    except (TypeError, ValueError):
        return None
    return (height, width) if height in SIDES and width in SIDES else None


AT_MOST = "at most "


def _parse_size(value: Any) -> Any:
    """Height and width, or words."""
    if value in ("auto", "original"):
        return value
    bound = isinstance(value, str) and value.startswith(AT_MOST)
    found = sides(value.removeprefix(AT_MOST) if bound else value)
    if found is None:
        raise PydanticCustomError(
            "size",
            f"expected height and width as in 416x576, each from {SIDES[0]} to {SIDES[-1]}, 'at "
            "most 416x576', 'auto' or 'original'",
        )
    return "{}{}x{}".format(AT_MOST, *found) if bound else found


Size = Annotated[tuple[int, int] | str, BeforeValidator(_parse_size)]
Phrase = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


RUNNERS = ("threads", "processes")
"""Who may do the work of a flow on this machine."""
CLUSTERS = ("dask", "ray")
"""Whose workers may, by the address of a cluster that runs."""


def _parse_runner(value: Any) -> str:
    kind, _, address = str(value).partition("://")
    host, _, port = address.rpartition(":")
    given = "://" in str(value)
    if kind in (CLUSTERS if given else RUNNERS) and (not given or (host and port.isdecimal())):
        return str(value)
    raise PydanticCustomError(
        "runner",
        "expected threads, processes, or for a cluster that runs dask://host:port or "
        f"ray://host:port{did_you_mean(kind, (*RUNNERS, *CLUSTERS))}",
    )


Runner = Annotated[str, BeforeValidator(_parse_runner)]


AnyModel = TypeVar("AnyModel", bound=BaseModel)

PRESETS = ("fast", "balanced", "paper")
"""Named settings, each a file in `presets`. The last is what the paper prints, see
`docs/reference/paper.md`."""


def _table_of(component: str) -> str:
    """Return the name of a component's table, for which TOML and Python take no hyphen."""
    return component.replace("-", "_")


class QueryRules(BaseModel):
    """How queries are answered."""

    model_config = ConfigDict(
        title="How queries are answered", extra="forbid", frozen=True, allow_inf_nan=False
    )

    protocol: str = Field(
        "slgaussian",
        examples=["slgaussian", "langsplat"],
        description="How answers are made: slgaussian, of whole objects, or langsplat, of smoothed "
        "relevancy.",
    )
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
        description="Without a threshold: select the objects that have this share of the best "
        "one's lead over the canonical phrases.",
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

    model_config = ConfigDict(
        title="How a field is built", extra="forbid", frozen=True, allow_inf_nan=False
    )

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
            name: dict(getattr(self, _table_of(name)))
            for name in self.component_names().values()
            if _table_of(name) in TABLES
        }

    def rules(self) -> dict[str, Any]:
        """How queries are answered, as :class:`slgaussian.language.query.Rules` takes it."""
        return self.model_dump(include=RULES)

    def part(self, kind: str) -> Component:
        """The part of a kind, with its settings; InputError if its files cannot be read."""
        name = getattr(self, kind)
        return Component.of(kind, name, self.component_values().get(name))

    @cached_property
    def built_by(self) -> BuildMethod:
        """How a field is built, as the library takes it; InputError if files cannot be read."""
        parts: dict[str, Any] = {kind: self.part(kind) for kind in KINDS}
        return BuildMethod(**parts, **self.model_dump(include=set(OWN)))

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What a field depends on besides the sample, as cache keys and artifacts hold it.

        The chosen parts, their settings with files by content, replicas, seed and what is kept.
        """
        return self.built_by.identity()


def _brought() -> Iterator[tuple[str, Any]]:
    """Yield table and default config of each component that another package brings."""
    for kind, known in KINDS.items():
        for name in brought(known.group):
            # What is wrong with one is said when it is asked for.
            with suppress(InputError):
                config = find_config(kind, name)
                if config.model_fields:
                    yield _table_of(name), (config, config())


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


def tables_of(*kinds: str) -> tuple[str, ...]:
    """The tables of the parts of these kinds, of all kinds if none is given."""
    named = [_table_of(name) for kind in kinds or KINDS for name in names_of(kind)]
    return tuple(table for table in TABLES if table in named)


def files_of(*kinds: str) -> tuple[str, ...]:
    """As ``table.key``, the settings that are files, folders or models of parts of these kinds."""
    return tuple(f"{t}.{key}" for t in tables_of(*kinds) for key in TABLES[t].files())


class SceneSettings(BaseModel):
    """One scene: where its photographs are and which of them are what."""

    model_config = ConfigDict(extra="forbid", frozen=True)

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

    @property
    def asked(self) -> dict[str, Any]:
        """What its samples are called, and what is asked without truth.

        ``place`` is the scene of the data that it is a pair of views of, where they hold several.
        """
        place = {"place": str(self.options["scene"])} if "scene" in self.options else {}
        return {"dataset": self.dataset, "queries": self.queries, **place}


class Engine(BaseModel):
    """Who does the work, and where it is kept."""

    model_config = ConfigDict(title="Who does the work")

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

    model_config = ConfigDict(title="The run")

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


PATHS = ("out", "data", "pairs", "labels", "models", "withdrawn")
"""The settings that are paths."""

URLS = ("store", "chunks")
"""The settings that may be URLs."""


AnySettings = TypeVar("AnySettings", bound=MethodSettings)


def settled(settings: AnySettings) -> AnySettings:
    """Return settings whose encoder is a real one; tell it, and the reason, if it was ``auto``."""
    if settings.encoder != AUTO:
        return settings
    place, reason = find_clip(settings.clip)
    chosen = "lexicon" if place is None else "clip"
    print(f"encoder auto: {chosen}, as {reason}", file=sys.stderr)
    update: dict[str, Any] = {"encoder": chosen}
    if place is not None:
        update["clip"] = settings.clip.model_copy(update={"model": place})
    return settings.model_copy(update=update)


def make_settings(values: dict[str, Any], source: str) -> Settings:
    """Check ``values``; InputError in one sentence, naming ``source``, the key and what fits.

    All of them must have an effect: none may be of a part that is not chosen.
    """
    settings = _validated(values, source)
    refuse_idle(values, settings, source)
    return settled(settings)


def checked(model: type[AnyModel], values: dict[str, Any], source: str) -> AnyModel:
    """``model(**values)``, or InputError in one sentence, naming ``source``, the key and why."""
    for name in URLS:
        if isinstance(values.get(name), str):
            check_url(values[name], f"{source}: {name}")
    try:
        config = model(**values)
    except ValidationError as error:
        raise InputError(f"{source}: {_sentence(error, model)}") from error
    if isinstance(config, MethodSettings):
        for kind, name in config.component_names().items():
            if name != AUTO:
                find_config(kind, name)  # refuses a name that nobody knows before any work
    return config


def _validated(values: dict[str, Any], source: str) -> Settings:
    if values.get("preset") is not None:
        values = layered(preset_values(values["preset"], source), values)
    settings = checked(Settings, values, source)
    names = [scene.name for scene in settings.scenes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{source}: two scenes are called {twice[0]!r}; names must be unique")
    return settings


def read_toml(path: Path, overrides: dict[str, Any]) -> Settings:
    """Read a configuration, over which ``overrides`` win.

    It may hold tables of parts that are not chosen, so that one is changed for another easily.

    Raises
    ------
    InputError
        If the file cannot be read, a key is unknown or a value does not fit.
    """
    settings = _validated(read_values(path, overrides), str(path))
    refuse_idle(overrides, settings, "run")
    return settled(settings)


def read_values(path: Path, overrides: dict[str, Any]) -> dict[str, Any]:
    """The values in a TOML file, and over them, key by key of a part's table, ``overrides``.

    Its relative paths are relative to the file, those given to hand not.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        values = tomllib.loads(path.read_text("utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the configuration ({error.strerror})") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not valid TOML ({error})") from error
    values = anchored(values, path.resolve().parent)
    return layered(values, overrides)


def preset_values(preset: Any, source: str) -> dict[str, Any]:
    """Return the settings of the named preset.

    Raises
    ------
    InputError
        If there is no such preset.
    """
    if preset not in PRESETS:
        raise InputError(
            f"{source}: preset: found {preset!r}, expected one of {', '.join(PRESETS)}"
            f"{did_you_mean(preset, PRESETS)}"
        )
    file = Path(__file__).parent / "presets" / f"{preset}.toml"
    return tomllib.loads(file.read_text("utf-8"))


def layered(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Return ``under`` with the values of ``over``, of a part's table key by key."""
    tables = {
        name: {**under[name], **over[name]}
        for name in TABLES
        if isinstance(under.get(name), dict) and isinstance(over.get(name), dict)
    }
    return {**under, **over, **tables}


def anchored(values: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A copy of settings whose relative paths are relative to ``folder``."""
    values = _anchored(values, PATHS, folder)
    for name in URLS:
        if isinstance(values.get(name), str) and "://" not in values[name]:
            values[name] = str(folder / values[name])
    if isinstance(values.get("scenes"), list):
        values["scenes"] = [_anchored(s, ("path", "labels"), folder) for s in values["scenes"]]
    if "training_set" in values:
        values["training_set"] = _anchored(values["training_set"], ["out"], folder)
    for name in TABLES.keys() & values.keys():
        if isinstance(values[name], dict):
            places = [
                key
                for key in TABLES[name].files().keys() & values[name].keys()
                if not TABLES[name].takes_name(key) or (folder / str(values[name][key])).exists()
            ]
            values[name] = _anchored(values[name], places, folder)
    return values


def refuse_idle(given: dict[str, Any], settings: MethodSettings, source: str) -> None:
    """InputError if ``given`` has the table of a part that the settings do not choose."""
    used = set(map(_table_of, settings.component_values()))
    if settings.encoder == AUTO:
        used |= set(CANDIDATES)
    for name in TABLES:
        if name in given and name not in used:
            chosen = ", ".join(
                f"{part} {name!r}" for part, name in settings.component_names().items()
            )
            raise InputError(
                f"{source}: settings of {name!r} are given, but no part is {name!r} (found "
                f"{chosen}); choose it, or leave them out"
            )


def _anchored(table: Any, keys: Sequence[str], folder: Path) -> Any:
    if not isinstance(table, dict):
        return table  # which is said where settings are checked
    places = {key: table[key] for key in keys if isinstance(table.get(key), str | Path)}
    return {**table, **{key: str(folder / place) for key, place in places.items()}}


SAID = {
    "path_type": "expected a path, in quotes",
    "model_type": "expected a table",
    "too_short": "expected at least {min_length}",
    "string_too_short": "expected some text",
}
"""What Pydantic says in its own terms, said in those of a configuration, by its error type."""


def _sentence(error: ValidationError, whole: type[BaseModel]) -> str:
    # A misspelt key leaves another one missing; it is the cause, so it goes first.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    place = [str(part) for part in first["loc"] if not str(part).startswith(("tuple", "literal"))]
    key = ".".join(place)
    if first["type"] == "extra_forbidden":
        model = SceneSettings if place[0] == "scenes" else whole
        listed = ", ".join(model.model_fields)
        near = did_you_mean(place[-1], model.model_fields)
        return f"unknown key {key!r}{near or f'; the keys are {listed}'}"
    if isinstance(first.get("ctx", {}).get("error"), InputError):
        return str(first["ctx"]["error"])  # of a component's config
    if first["type"] == "missing":
        return f"{key} is missing"
    if first["type"] in SAID:
        message = SAID[first["type"]].format(**first.get("ctx", {}))
    else:
        message = first["msg"][0].lower() + first["msg"][1:]
    return f"{key}: found {first['input']!r}; {message}"
