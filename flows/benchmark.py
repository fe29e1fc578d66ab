"""The main flow: from photographs of many scenes to fields, scores and a report."""

from __future__ import annotations

import json
import os
import platform
import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
from prefect import flow
from prefect.states import State

from flows.config import SceneSettings, Settings, check_names
from flows.results import check_places, field_place, manifest, run_toml, write_fields
from flows.runners.batches import (
    Failure,
    Outcome,
    SceneTask,
    map_scenes,
    state_after,
    write_failures,
)
from flows.runners.progress import Progress
from flows.runners.session import (
    check_folder,
    check_refresh,
    final,
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
from flows.scenes import DATASET, PATH_SUBDIVISIONS, labelled_scenes, room_scene, seeds
from flows.sweep import VIEWS, combinations, sweep_tasks
from slgaussian.benchmark.costs import StageCost, Times, measure_costs
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.lineage import lineage_table
from slgaussian.benchmark.outputs import Masks, write_masks, write_samples, write_table
from slgaussian.benchmark.reports.run_report import with_times
from slgaussian.benchmark.scores import Rows
from slgaussian.errors import InputError
from slgaussian.io import write_atomic
from slgaussian.kernels import threads
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from slgaussian.storage.tables import read_table
from tasks.artifacts import decode_predictions, result_from_arrays
from tasks.benchmark import Scored, baselines, report
from tasks.stage import Stage

BUILDING_STAGES = ("geometry", "masks", "supervision", "field")
"""Stages that build a field from a sample."""

REFRESHABLE = [stage.name for stage in (*STAGES, baselines, report)]
"""Stages that ``refresh`` may name."""

SWEPT_STAGES = len(STAGES) - 1
"""Number of stages of a scene in a sweep: all but attribution."""

PAGE, REPORT, SCORES = "slgaussian-page", "slgaussian-report", "slgaussian-scores"
"""Keys of the Prefect artifacts of a run."""

RUN_FILES = ("manifest.json", "pairs.json", "report.html", "report.md", "run.toml", "times.json")
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


@flow(name="slgaussian", flow_run_name="run {config.out.name}", persist_result=False)
def score_scenes(config: Settings, verbose: bool = False) -> State[RunResult]:
    """Score the method and baselines on many scenes; write tables, masks, fields and report.

    The final state is Failed if all scenes were left out, ``LeftOut`` if some were, and names them.
    On an external Prefect server, report and scores are also published as Prefect artifacts.

    Args:
        verbose: Print a line for every stage.

    Raises:
        InputError: If there are no scenes, a component is unknown, or the store or the output
            folder cannot be written.
    """
    result = run_session("run", config, _score, verbose)
    message = f"report: {result.report}" if result.report else "no report"
    if result.report is not None:
        publish(PAGE, result.report, "Report with pictures")
        page = result.report.with_suffix(".md").read_text("utf-8")
        publish(REPORT, page, "Report without pictures")
        scores = read_table(config.out / "scores.parquet").to_pylist()
        publish(SCORES, scores, "Scores by data set, method, protocol and metric, with intervals")
    return final(state_after(message, result, result.failures, not result.results))


def check(config: Settings, store: ArtifactStore) -> tuple[list[SceneSettings], list[str]]:
    """Check a run before the work; return its scenes, and messages about them.

    InputError as in :func:`score_scenes`.
    """
    scenes, notes = find_scenes(config)
    for settings in (config, *(variant.settings for variant in combinations(config))):
        settings.field_method.check()
    chosen_baselines(config.against)
    check_refresh(config, REFRESHABLE)
    store.check_writable()
    check_folder(config.out)
    check_places([scene.name for scene in scenes], config.out)
    return scenes, notes


@dataclass
class _Computed:
    """Artifacts of a run.

    Attributes:
        scored: The completed scenes.
        refs: Results of all stages by scene and method, those of our method first; also of scenes
            that failed later.
        costs: Costs of each stage when its artifacts were computed, possibly in an earlier run.
    """

    scored: list[Scored]
    refs: dict[tuple[str, str], dict[str, ArtifactRef]]
    costs: dict[str, StageCost]
    manifest: dict[str, Any]
    failures: list[Failure]
    report: ArtifactRef | None = None


def _score(config: Settings, store: ArtifactStore, verbose: bool) -> RunResult:
    scenes, notes = check(config, store)
    with open_workers(config, store) as workers:
        progress = Progress(len(scenes), len(STAGES), verbose)
        names = ", ".join(part.name for part in config.field_method.components)
        for text in (f"with {names}", *notes):
            progress.line(text)
        computed = _compute(config, scenes, workers, progress)
    for scene, data in computed.manifest["data"].items():
        for name, reason in data["left_out"].items():
            progress.line(f"warning: {scene}: {name} is left out: {reason}")
    fields = {
        scene: refs["field"]
        for (scene, method), refs in computed.refs.items()
        if method == config.method and "field" in refs
    }
    with writing(config.out):
        results = _write(config, store, scenes, computed)
        write_fields(store, fields, config.field_method.encoder.places(), config.out)
    page = None if computed.report is None else config.out / "report.html"
    return RunResult(results, computed.failures, page, _example(computed, fields, config.out))


def _compute(
    config: Settings, scenes: Sequence[SceneSettings], workers: Workers, progress: Progress
) -> _Computed:
    """Run the pipelines of all scenes, the baselines and the sweep, and write the report."""

    def compute(tasks: Sequence[SceneTask], stages: int, unit: str) -> Outcome:
        return map_scenes(tasks, workers, Progress(len(tasks), stages, progress.verbose, unit=unit))

    ours = map_scenes([scene_task(config, scene) for scene in scenes], workers, progress)
    complete = [scene for scene in scenes if scene.name in ours.refs]
    answered = compute(baseline_tasks(config, complete, ours.refs), 1, "answers")
    variants, rows = combinations(config), chosen_baselines(config.against)
    tasks, refused = sweep_tasks(variants, complete)
    swept = compute(tasks, SWEPT_STAGES, "settings")
    methods = rows | {variant.name: variant.row for variant in variants}
    further_refs, started = answered.refs | swept.refs, ours.partial | ours.refs
    every = {(s.name, config.method): started[s.name] for s in scenes if s.name in started}
    scored = []
    for name in (scene.name for scene in complete):
        refs, answers = ours.refs[name], dict[str, ArtifactRef]()
        for method in methods:
            if method_refs := further_refs.get(method_task_name(name, method)):
                every[name, method] = method_refs
                answers[method] = [*method_refs.values()][-1]  # of the last stage
        scored.append(Scored(name, refs["benchmark"], refs["truth"], refs["attribution"], answers))
    costs = {stage.name: _cost(stage, ours) for stage in STAGES}
    stages = [*STAGES, report]
    if rows:
        costs[baselines.name] = _cost(baselines, answered)
        stages.append(baselines)
    failures = [*ours.failures, *answered.failures, *swept.failures, *refused]
    described = manifest(config, complete, stages, ours.refs, methods)
    computed = _Computed(scored, every, costs, described, failures)
    if scored:
        arguments = scored, described, [asdict(failure) for failure in failures]
        last = SceneTask("all scenes", report, arguments, first="report")
        outcome = compute([last], 1, "report")
        failures += outcome.failures
        computed.report = outcome.refs.get("all scenes", {}).get("report")
    return computed


def _cost(stage: Stage, outcome: Outcome) -> StageCost:
    return StageCost.of([refs[stage.name].meta for refs in outcome.refs.values()])


def find_scenes(settings: Settings) -> tuple[list[SceneSettings], list[str]]:
    """Return the scenes of a run, of a labelled set, procedural rooms and a list, and messages."""
    labelled = any((settings.data, settings.pairs, settings.labels))
    scenes, notes = labelled_scenes(settings) if labelled else ([], [])
    if settings.rooms is not None:
        swept = any(text.partition("=")[0].strip() == VIEWS for text in settings.sweep)
        thirds = PATH_SUBDIVISIONS if swept else 1
        scenes = [*scenes, *(room_scene(seed, thirds) for seed in seeds(settings.rooms, "rooms"))]
    scenes = [*scenes, *settings.scenes]
    if not scenes:
        raise InputError("nothing to do: give [[scenes]], or data and pairs, or rooms")
    check_names(scenes)
    return scenes, notes


def _write(
    settings: Settings,
    store: ArtifactStore,
    scenes: Sequence[SceneSettings],
    computed: _Computed,
) -> list[SceneResult]:
    """Write all outputs but fields; return the results without images, of which there are many."""
    out = settings.out
    write_failures(out, computed.failures)
    results, parts = list[SceneResult](), list[Rows]()

    def masks() -> Iterator[tuple[str, str, Masks]]:
        for scored in computed.scored:
            for method, ref in {settings.method: scored.answer, **scored.others}.items():
                refs = computed.refs[scored.scene, method]
                if "field" not in refs:  # a baseline answers from our field
                    refs = computed.refs[scored.scene, settings.method]
                seconds = sum(refs[stage].meta["seconds"] for stage in BUILDING_STAGES)
                arrays = store.get(ref)
                result = result_from_arrays(arrays)
                results.append(replace(result, rows=Rows.from_rows(result.rows)))
                answers = [{**row, "build_seconds": seconds} for row in ref.meta["costs"]]
                parts.append(Rows.from_rows(answers, "times"))
                yield result.method, result.scene, decode_predictions(arrays)

    write_masks(masks(), out)
    rows = Rows.join(result.rows for result in results)
    write_samples(rows, out)
    costs = Rows.join(parts, "times")
    write_table("times", costs.table, out)
    lost = [store.get(scored.attribution) for scored in computed.scored]
    empty = load_spec("attribution").schema.empty_table()
    write_table("attribution", pa.concat_tables([empty, *lost]), out)
    write_table("lineage", lineage_table(computed.refs, computed.manifest["stages"]), out)
    repeat = run_toml(settings, scenes, computed.refs)
    files = {"manifest.json": _json(computed.manifest), "run.toml": repeat}
    if settings.pairs is not None:
        files["pairs.json"] = settings.pairs.read_bytes()
    if computed.report is not None:
        host = {
            "machine": platform.platform(),
            "processor": threads.processor(),
            "processors": str(os.cpu_count()),
            "workers": str(settings.workers),
        }
        paper = settings.method if settings.preset == "paper" else ""
        times = Times(computed.costs, host, measure_costs(costs), paper)
        pages = store.get(computed.report)
        names = {"html": "html", "md": "markdown"}
        forms = {form: pages[name].tobytes().decode() for form, name in names.items()}
        novel = [(r.dataset, r.method, r.scene_metrics["psnr"])
                 for r in results if "psnr" in r.scene_metrics]  # fmt: skip
        for form, page in with_times(forms, times, rows, novel).items():
            files[f"report.{form}"] = page.encode()
        files["times.json"] = _json(times.as_json())
    for name in RUN_FILES:
        if name in files:
            write_atomic(out / name, files[name])
        else:
            # The file of an earlier run describes other scenes.
            (out / name).unlink(missing_ok=True)
    return results


def _example(computed: _Computed, fields: Iterable[str], out: Path) -> str:
    """Return a command that queries a field, to be pasted into a shell.

    It is for the first scene with an example query, preferring photographs to procedural rooms and
    answers that are known to be correct. Without such a scene, the command renders a field.
    """
    examples = {scored.scene: scored.answer.meta["example"] for scored in computed.scored}

    def rank(scene: str) -> tuple[bool, ...]:
        if not (example := examples.get(scene)):
            return (True,)
        is_room = computed.manifest["data"][scene]["dataset"] == DATASET
        return False, is_room, example["iou"] is None

    scene = min(fields, key=rank, default=None)
    if scene is None:
        return ""
    folder = field_place(scene, out)
    with suppress(ValueError):  # not below the working folder
        folder = folder.relative_to(Path.cwd())
    if example := examples.get(scene):
        return shlex.join(["slgaussian", "query", str(folder), example["text"], "-o", "hit.png"])
    return shlex.join(["slgaussian", "render", str(folder), "-o", "picture.png"])


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()
