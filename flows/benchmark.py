"""The main flow: from photographs of many scenes to fields, scores and a report."""

from __future__ import annotations

import json
import os
import platform
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
from prefect import flow
from prefect.states import State

from flows.config import SceneSettings, Settings
from flows.results import check_places, field_place, manifest, write_fields
from flows.runners.batches import Failure, Outcome, SceneTask, map_scenes, map_shown, write_failures
from flows.runners.progress import Progress
from flows.runners.session import (
    check_folder,
    completed,
    publish,
    run_session,
    writing,
)
from flows.runners.task_runners import Workers, open_workers
from flows.scene import (
    STAGES,
    baseline_tasks,
    chosen_baselines,
    method_task_name,
    scene_task,
)
from flows.scenes import DATASET, THIRDS, labelled_scenes, room_scene, seeds
from flows.sweep import VIEWS, Combination, combinations, sweep_tasks
from slgaussian.benchmark.costs import StageCost, Times, costs_of
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.outputs import (
    clear_predictions,
    write_costs,
    write_predictions,
    write_samples,
    write_table,
)
from slgaussian.benchmark.reports.run_report import with_times
from slgaussian.errors import InputError
from slgaussian.io import write_atomic
from slgaussian.kernels import threads
from slgaussian.language.rules import Rules
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from slgaussian.storage.tables import read_table
from tasks.artifacts import predictions_of, result_from_arrays
from tasks.benchmark import Scored, baselines, report

BUILDING = ("geometry", "masks", "supervision", "field")
"""Stages that build a field from a sample."""

SWEPT = len(STAGES) - 1
"""Number of stages of a scene in a sweep: all but attribution."""

REPORT, SCORES = "slgaussian-report", "slgaussian-scores"
"""Keys of the Prefect artifacts of a run."""

LEFT = ("manifest.json", "pairs.json", "report.html", "report.md", "times.json")
"""Files of a run besides its tables and masks; those of an earlier run are removed."""


@dataclass(frozen=True)
class RunResult:
    """Results of a run.

    Attributes:
        results: list of SceneResult. In the order of the scenes, for each scene our method first.
        failures: list of Failure. Scenes and methods that were left out.
        ready: A command that queries the field of one of the scenes; empty if there is no field.
    """

    results: list[SceneResult]
    failures: list[Failure]
    report: Path | None
    ready: str

    @property
    def look(self) -> str:
        """A command that opens the field of ``ready`` in the browser, or empty."""
        return shlex.join(["slgaussian", "view", shlex.split(self.ready)[2]]) if self.ready else ""


@flow(name="slgaussian", persist_result=False)
def score_scenes(config: Settings, verbose: bool = False) -> State[RunResult]:
    """Score the method and baselines on many scenes; write tables, masks, fields and report.

    The final state names the scenes that were left out. On an external Prefect server, report and
    scores are also published as Prefect artifacts.

    Args:
        verbose: Print a line for every stage.

    Raises:
        InputError: If there are no scenes, a component is unknown, or the store or the output
            folder cannot be written.
    """
    result = run_session("run", config, lambda store: _score(config, store, verbose))
    message = f"report: {result.report}" if result.report else "no report"
    if result.report is not None:
        publish(REPORT, result.report.with_suffix(".md").read_text("utf-8"))
        publish(SCORES, read_table(config.out / "scores.parquet").to_pylist())
    return completed(message, result, result.failures)


def check(config: Settings, store: ArtifactStore) -> None:
    """Check a run before the work; InputError as in :func:`score_scenes`."""
    scenes, _ = scenes_of(config)
    for method in (
        config.built_by,
        *(variant.settings.built_by for variant in combinations(config)),
    ):
        method.check()
    Rules.of(config)
    chosen_baselines(config.against)
    store.check_writable()
    check_folder(config.out)
    check_places([scene.name for scene in scenes], config.out)


def _score(config: Settings, store: ArtifactStore, verbose: bool) -> RunResult:
    check(config, store)
    scenes, notes = scenes_of(config)
    variants, method = combinations(config), config.built_by
    with open_workers(config.runner, config.workers, store) as workers:
        progress = Progress(len(scenes), len(STAGES), verbose=verbose)
        for text in (f"with {', '.join(part.name for part in method.components)}", *notes):
            progress.line(text)
        refs = _compute(config, scenes, variants, workers, progress)
    for scene, data in refs.manifest.get("data", {}).items():
        for name, reason in data["left_out"].items():
            progress.line(f"warning: {scene}: {name} has no camera and is left out: {reason}")
    with writing(config.out):
        results = _write(config, store, refs)
    page = None if refs.report is None else config.out / "report.html"
    return RunResult(results, refs.failures, page, _example(refs, config.out))


def _compute(
    config: Settings,
    scenes: Sequence[SceneSettings],
    variants: Sequence[Combination],
    workers: Workers,
    progress: Progress,
) -> _Refs:
    """Run the pipelines of all scenes, the baselines and the sweep, and write the report."""
    method, verbose = config.built_by, progress.verbose
    with progress:
        ours = map_scenes(
            [scene_task(config, method, scene) for scene in scenes], workers, progress
        )
    tasks = baseline_tasks(config, method, scenes, ours.refs)
    baseline_outcome = map_shown(tasks, workers, 1, "answers", verbose)
    complete = [scene for scene in scenes if scene.name in ours.refs]
    by_names, refused = sweep_tasks(variants, complete)
    swept = map_shown(list(by_names.values()), workers, SWEPT, "settings", verbose)
    swept.failures += refused
    refs = _gather(config, scenes, variants, ours, baseline_outcome, swept)
    if refs.scored:
        failures = [asdict(failure) for failure in refs.failures]
        arguments = refs.scored, refs.manifest, failures
        last = SceneTask("all scenes", report, arguments, first="report")
        outcome = map_shown([last], workers, 1, "report", verbose)
        refs.failures += outcome.failures
        refs.report = outcome.refs.get("all scenes", {}).get("report")
    return refs


def scenes_of(settings: Settings) -> tuple[list[SceneSettings], list[str]]:
    """Return the scenes of a run, of a labelled set, procedural rooms and a list, and messages."""
    labelled = any((settings.data, settings.pairs, settings.labels))
    scenes, notes = labelled_scenes(settings) if labelled else ([], [])
    if settings.rooms is not None:
        swept = any(text.partition("=")[0].strip() == VIEWS for text in settings.sweep)
        thirds = THIRDS if swept else 1
        scenes = [*scenes, *(room_scene(seed, thirds) for seed in seeds(settings.rooms, "rooms"))]
    scenes = [*scenes, *settings.scenes]
    if not scenes:
        raise InputError("nothing to do: give [[scenes]], or data and pairs, or rooms")
    names = [scene.name for scene in scenes]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two scenes are called {name!r}; names must be unique")
    return scenes, notes


def _write(settings: Settings, store: ArtifactStore, refs: _Refs) -> list[SceneResult]:
    """Write all outputs; return the results without images, of which there may be thousands."""
    out = settings.out
    write_failures(out, refs.failures)
    results, costs = [], []
    scored = [
        (scene_refs.scene, ref)
        for scene_refs in refs.scored
        for ref in (scene_refs.answer, *scene_refs.others.values())
    ]
    for scene, ref in scored:
        arrays = store.get(ref)
        result = result_from_arrays(arrays)
        write_predictions(result.rows, predictions_of(arrays), out / "predictions")
        results.append(result)
        shared = refs.build_seconds[scene, ""]
        build = {"build_seconds": refs.build_seconds.get((scene, result.method), shared)}
        costs += [{**row, **build} for row in ref.meta["costs"]]
    rows = [row for result in results for row in result.rows]
    clear_predictions(rows, out)
    write_samples(rows, out)
    write_costs(costs, out)
    lost = [
        load_spec("attribution").schema.empty_table(),
        *(store.get(scene_refs.attribution) for scene_refs in refs.scored),
    ]
    write_table("attribution", pa.concat_tables(lost), out)
    files = {"manifest.json": _json(refs.manifest)}
    if settings.pairs is not None:
        files["pairs.json"] = settings.pairs.read_bytes()
    if refs.report is not None:
        host = {
            "machine": platform.platform(),
            "processor": threads.processor(),
            "processors": str(os.cpu_count()),
            "workers": str(settings.workers),
        }
        paper = settings.method if settings.preset == "paper" else ""
        took = Times(refs.stages, host, costs_of(costs), paper)
        stored = store.get(refs.report)
        forms = {form: stored[name].tobytes().decode()
                 for form, name in (("html", "html"), ("md", "markdown"))}  # fmt: skip
        novel = [(r.dataset, r.method, r.scene_metrics["psnr"])
                 for r in results if "psnr" in r.scene_metrics]  # fmt: skip
        pages = with_times(forms, took, rows, novel)
        files |= {f"report.{form}": page.encode() for form, page in pages.items()}
        files["times.json"] = _json(took.as_json())
    for name in LEFT:
        if name in files:
            write_atomic(out / name, files[name])
        else:
            # The file of an earlier run describes other scenes.
            (out / name).unlink(missing_ok=True)
    write_fields(store, refs.fields, settings.built_by.encoder.places(), out)
    return results


def _example(refs: _Refs, out: Path) -> str:
    """Return a command that queries a field, to be pasted into a shell.

    It is for the first scene with an example query, preferring photographs to procedural rooms and
    answers that are known to be correct. Without such a scene, the command renders a field.
    """
    by_scene = {scored.scene: scored.answer.meta["example"] for scored in refs.scored}
    examples = {scene: example for scene, example in by_scene.items() if example is not None}
    data = refs.manifest["data"]
    best = sorted(
        examples,
        key=lambda scene: (data[scene]["dataset"] == DATASET, examples[scene]["iou"] is None),
    )
    scene = next(iter([*best, *refs.fields]), None)
    if scene is None:
        return ""
    folder = field_place(scene, out)
    with suppress(ValueError):  # not below the working folder
        folder = folder.relative_to(Path.cwd())
    if scene not in examples:
        return shlex.join(["slgaussian", "render", str(folder), "-o", "picture.png"])
    text = examples[scene]["text"]
    return shlex.join(["slgaussian", "query", str(folder), text, "-o", "hit.png"])


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


@dataclass
class _Refs:
    """Artifacts of the pipelines of a run.

    ``scored`` are the completed scenes with the results of all methods; ``fields`` are the fields
    by scene, including scenes that failed later. ``build_seconds`` are the times to build a field,
    by scene and name of the sweep's combination, empty for the field of the method and baselines.
    ``stages`` has the costs of each stage when its artifacts were computed, possibly in an earlier
    run.
    """

    scored: list[Scored]
    fields: dict[str, ArtifactRef]
    build_seconds: dict[tuple[str, str], float]
    stages: dict[str, StageCost]
    manifest: dict[str, Any]
    failures: list[Failure]
    report: ArtifactRef | None = None


def _gather(
    settings: Settings,
    scenes: Sequence[SceneSettings],
    variants: Sequence[Combination],
    ours: Outcome,
    baseline_outcome: Outcome,
    swept: Outcome,
) -> _Refs:
    rows = chosen_baselines(settings.against)
    scored, build_seconds = [], {}
    for scene in (scene.name for scene in scenes if scene.name in ours.refs):
        refs, results = ours.refs[scene], {}
        build_seconds[scene, ""] = _seconds_to_build(refs)
        for method in rows:
            if method_refs := baseline_outcome.refs.get(method_task_name(scene, method)):
                results[method] = method_refs[baselines.name]
        for variant in variants:
            if method_refs := swept.refs.get(method_task_name(scene, variant.name)):
                results[variant.name] = method_refs["benchmark"]
                build_seconds[scene, variant.name] = _seconds_to_build(method_refs)
        artifacts = refs["benchmark"], refs["truth"], refs["attribution"]
        scored.append(Scored(scene, *artifacts, results))
    costs = {
        stage.name: StageCost.of(refs[stage.name].meta for refs in ours.refs.values())
        for stage in STAGES
    }
    stages = [*STAGES, report]
    if rows:
        costs[baselines.name] = StageCost.of(
            refs[baselines.name].meta for refs in baseline_outcome.refs.values()
        )
        stages.append(baselines)
    started, outcomes = ours.partial | ours.refs, [ours, baseline_outcome, swept]
    return _Refs(
        scored,
        {s.name: refs["field"] for s in scenes if "field" in (refs := started.get(s.name, {}))},
        build_seconds,
        costs,
        manifest(settings, scenes, stages, ours.refs, rows | {v.name: v.row for v in variants}),
        [failure for outcome in outcomes for failure in outcome.failures],
    )


def _seconds_to_build(refs: Mapping[str, ArtifactRef]) -> float:
    return sum(refs[stage].meta["seconds"] for stage in BUILDING)
