"""The main job with several numbers of context views: the same targets, a report for each number.

A run of :mod:`flows.pipeline` for each number, below the output folder, and over them a page and a
table of what each number is worth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import pyarrow as pa

from flows import pipeline
from flows.pipeline import Cost, Finished, check_folder, scenes_of
from flows.runners.shard import Failure
from flows.runners.worker_pool import failures_file
from flows.settings import SceneSettings, Settings
from slgaussian import datasets
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.outputs import write_table
from slgaussian.benchmark.view_counts import SHOWN, Counts, counts_of, folder, render_view_counts
from slgaussian.datasets import further
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore, write_atomic

TABLE = "view_counts"
PAGES = "views.html", "views.md"

ByNumber = dict[int, SceneSettings]
"""A scene with each number of context views."""


def run(settings: Settings, store: ArtifactStore, verbose: bool = False) -> Finished:
    """Run the pipeline once, or, where ``settings.views`` says so, for each number of views.

    Needs Prefect to be ready, as :func:`flows.pipeline.run`.

    Raises
    ------
    InputError
        As :func:`flows.pipeline.run`, and if no scene has as many views as the most asked for.
    """
    if settings.views is None:
        return pipeline.run(settings, store, verbose)
    scenes, said = scenes_of(settings)
    check_folder(settings.out)
    chosen, failures = _with_numbers(scenes, settings.views)
    finished = {
        number: pipeline.run(
            settings.model_copy(update={"out": settings.out / folder(number)}),
            store,
            verbose,
            ([own[number] for own in chosen], [f"{number} context views", *said]),
        )
        for number in settings.views
    }
    for number, one in finished.items():
        failures += [
            Failure(f"{failed.scene}, {number} views", failed.stage, failed.kind, failed.reason)
            for failed in one.failures
        ]
    counts = _write(settings, chosen, finished, failures)
    page = settings.out / PAGES[0]
    return Finished([], failures, page, finished[max(finished)].ready, counts=counts)


def _with_numbers(
    scenes: Sequence[SceneSettings], numbers: Sequence[int]
) -> tuple[list[ByNumber], list[Failure]]:
    """Each scene with each number of context views, and the scenes that have not so many."""
    chosen, failures = [], []
    for scene in scenes:
        try:
            chosen.append(_by_number(scene, numbers))
        except InputError as error:
            failures.append(Failure(scene.name, "views", type(error).__name__, str(error)))
    if not chosen:
        raise InputError(
            f"views: no scene has {max(numbers)} context views for its targets; of "
            f"{failures[0].scene!r}: {failures[0].reason}"
        )
    return chosen, failures


def _by_number(scene: SceneSettings, numbers: Sequence[int]) -> ByNumber:
    if not scene.targets:
        raise InputError(f"scene {scene.name!r}: has no targets to compare numbers of views at")
    paths = [] if scene.path is None else [scene.path]
    known = datasets.load(scene.format, *paths, **scene.options)
    return {
        number: scene.model_copy(
            update={
                "context": list(further.context_of(known, scene.context, scene.targets, number))
            }
        )
        for number in numbers
    }


def _write(
    settings: Settings,
    chosen: Sequence[ByNumber],
    finished: Mapping[int, Finished],
    failures: Sequence[Failure],
) -> list[Counts]:
    """Write the table, the page and who was left out; the table of each data set."""
    rows = [
        _row(own[number], number, result, one.costs[result.scene])
        for number, one in finished.items()
        for own in chosen
        for result in one.results
        if result.scene == own[number].name and result.method == settings.method
    ]
    seconds = {
        (scene, number): cost.seconds
        for number, one in finished.items()
        for scene, cost in one.costs.items()
    }
    schema = load_spec(TABLE).schema
    write_table(TABLE, pa.Table.from_pylist(rows, schema=schema), settings.out)
    write_atomic(settings.out / "failures.parquet", failures_file(failures))
    parts = ", ".join(part.name for part in settings.built_by.parts)
    said = f"Built with {parts}; further views by the rule {further.NAME}@{further.VERSION}"
    report = render_view_counts(rows, seconds, [asdict(failure) for failure in failures], said)
    for name, text in zip(PAGES, (report.html, report.markdown), strict=True):
        write_atomic(settings.out / name, text.encode())
    return counts_of(rows, seconds)


def _row(scene: SceneSettings, number: int, result: SceneResult, cost: Cost) -> dict[str, Any]:
    """A row of the spec ``view_counts``."""
    return {
        "dataset": scene.dataset,
        "scene": scene.name,
        "place": scene.asked.get("place"),
        "views": number,
        "context": ", ".join(scene.context),
        "gaussians": cost.gaussians,
        "kept": cost.kept,
        **{key: result.scene_metrics.get(key) for key in SHOWN},
    }
