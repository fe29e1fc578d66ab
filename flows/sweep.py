"""Combinations of settings that a benchmark compares, each as a method of the report.

``FIELD=a,b,c`` names a setting and its values; several of them give all combinations. Stages that
do not depend on a changed setting are read from the store.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from flows.config import TABLES, Method, SceneSettings, Settings
from flows.forms import merge_tables, preset_values
from flows.read_config import refuse_idle, validate_settings
from flows.runners.batches import Failure, SceneTask
from flows.scene import method_task_name, scene_task
from slgaussian import datasets
from slgaussian.benchmark.baselines import Row
from slgaussian.datasets import context_views
from slgaussian.errors import InputError, did_you_mean
from slgaussian.language.rules import Rules

VIEWS, PRESET = "views", "preset"
"""Fields besides the method's settings: the number of context views, and the preset."""


@dataclass(frozen=True)
class Combination:
    """A run's settings with some fields changed.

    Attributes:
        fields: {field: value as text}
        views: Number of context views, at least 2; None for those of each scene.
    """

    settings: Settings
    fields: Mapping[str, str]
    views: int | None = None

    @property
    def name(self) -> str:
        """Name of the method in the report."""
        changed = ", ".join(f"{key.rpartition('.')[2]}={v}" for key, v in self.fields.items())
        return f"{self.settings.method}, {changed}"

    @property
    def row(self) -> Row:
        """Row in the table of methods."""
        title = "the field, with other settings"
        return Row(self.settings.method, title, dict(self.fields), {}, variant=True)

    def choose_views(self, scene: SceneSettings) -> SceneSettings:
        """Return the scene with :attr:`views` context views.

        Raises:
            InputError: If it has no targets, or not enough views around them.
        """
        if self.views is None:
            return scene
        if not scene.targets:
            raise InputError(f"scene {scene.name!r}: has no targets to compare numbers of views at")
        paths = [] if scene.path is None else [scene.path]
        scene_data = replace(datasets.load(scene.format, *paths, **scene.options), name=scene.name)
        context = context_views.choose_context(scene_data, scene.context, scene.targets, self.views)
        return scene.model_copy(update={"context": list(context)})


def combinations(settings: Settings) -> list[Combination]:
    """Return all combinations of the values in ``settings.sweep``.

    A combination that equals the run itself is omitted.

    Raises:
        InputError: If a field is unknown or named twice, or a value is invalid.
    """
    axes = [_axis(text) for text in settings.sweep]
    names = [name for name, _ in axes]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"sweep: {name!r} is named twice; give all its values at once")
    variants = []
    for values in product(*(values for _, values in axes)) if axes else ():
        fields = dict(zip(names, values, strict=True))
        variant = _combination(settings, fields)
        if variant.views is not None or _outcome(variant.settings) != _outcome(settings):
            variants.append(variant)
    return variants


def sweep_tasks(
    variants: Sequence[Combination], scenes: Sequence[SceneSettings]
) -> tuple[list[SceneTask], list[Failure]]:
    """Return a task for each scene and combination, and the failures."""
    scene_tasks, failures = [], []
    for variant, scene in product(variants, scenes):
        try:
            scene_tasks.append(
                scene_task(variant.settings, variant.choose_views(scene), variant.name)
            )
        except InputError as error:
            name = method_task_name(scene.name, variant.name)
            failures.append(Failure(name, VIEWS, type(error).__name__, str(error)))
    return scene_tasks, failures


def _axis(text: str) -> tuple[str, list[str]]:
    field, mark, values = text.partition("=")
    field, listed = field.strip().replace("-", "_"), [value.strip() for value in values.split(",")]
    if not mark or not field or "" in listed or len(set(listed)) < len(listed):
        raise InputError(
            f"sweep: found {text!r}, expected FIELD=a,b,c with different values, as "
            "planesweep.depth_candidates=32,64 or views=2,3"
        )
    return field, listed


def _combination(settings: Settings, fields: Mapping[str, str]) -> Combination:
    changes: dict[str, Any] = {}
    views = None
    for field, value in fields.items():
        table, dot, key = field.partition(".")
        if field == VIEWS:
            if not value.isdecimal() or int(value) < 2:
                raise InputError(f"sweep: views: found {value!r}, expected a number from 2")
            views = int(value)
        elif field == PRESET:
            changes = merge_tables(changes, {**preset_values(value), PRESET: value})
        elif dot and table in TABLES:
            changes = merge_tables(changes, {table: {**changes.get(table, {}), key: value}})
        elif field in Method.model_fields:
            changes[field] = value
        else:
            valid = (VIEWS, PRESET, *Method.model_fields, *(f"{t}." for t in TABLES))
            raise InputError(
                f"sweep: found no setting {field!r}{did_you_mean(field, valid)}; expected one of "
                f"the method's, as in a configuration file, or views or preset"
            )
    base = settings.model_dump()
    changed = validate_settings(Settings, merge_tables(base, changes), "sweep")
    refuse_idle(changes, changed, "sweep")
    return Combination(changed, fields, views)


def _outcome(settings: Settings) -> tuple[Any, ...]:
    """Return all settings on which answers depend."""
    return settings.size, repr(settings.field_method.identity()), Rules.of(settings)
