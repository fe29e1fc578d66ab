"""The main job: photographs of many scenes in; fields, scores and a report out."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from flows import rivals
from flows.chains import Chain, Failure, Outcome, Step, failures_table, run_chains
from flows.labelled import labelled_scenes
from flows.progress import Progress
from flows.rooms import room_scene, seeds
from flows.settings import TABLES, Method, SceneSettings, Settings
from slgaussian import __version__
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.labels import label_files
from slgaussian.benchmark.report import with_times, write_predictions, write_samples
from slgaussian.build import check_parts
from slgaussian.errors import InputError
from slgaussian.language.query import Rules
from slgaussian.parts import places
from slgaussian.store import ArtifactRef, ArtifactStore, encode_table, sha256_of, write_atomic
from tasks.artifacts import predictions_of, result_from_arrays
from tasks.ingest import file_hashes
from tasks.stage import stage_task, using

STAGES = ("ingest", "truth", "geometry", "masks", "supervision", "field", "benchmark")


@dataclass(frozen=True)
class Finished:
    """What a run leaves: results in the order of the scenes, and who was left out."""

    results: list[SceneResult]
    failures: list[Failure]
    report: Path | None


def run(settings: Settings, store: ArtifactStore, verbose: bool = False) -> Finished:
    """Run the pipeline and write its tables, masks and report to ``settings.out``.

    Needs Prefect to be ready (:func:`flows.environment.orchestration`).

    Raises
    ------
    InputError
        If there is nothing to do, a part of the method is unknown, or the store or the output
        folder cannot be written.
    """
    scenes, said = scenes_of(settings)
    parts = settings.part_names()
    check_parts(**parts, settings=settings.part_settings())
    Rules(**settings.rules())
    store.check_writable()
    check_folder(settings.out)
    progress = Progress(len(scenes), len(STAGES), more=1, verbose=verbose)
    for text in (f"with {', '.join(parts.values())}", *said):
        progress.line(text)
    made = _pipeline(settings, scenes, store, progress)
    page = None
    if made.report is not None:
        page = with_times(
            store.get(made.report)["html"].tobytes().decode(),
            made.seconds,
            {name: ref.meta["times"] for name, ref in made.answers.items()},
            {"python": platform.python_version(), "machine": platform.platform()},
        )
    try:
        results = _write(settings.out, store, made, page)
    except OSError as error:
        raise InputError(
            f"{settings.out}: cannot write the results ({error.strerror}); they are kept in the "
            "store, so make room there, or choose another folder with -o, and run again"
        ) from error
    progress.summary()
    written = None if page is None else settings.out / "report.html"
    return Finished(results, made.failures, written)


def scenes_of(settings: Settings) -> tuple[list[SceneSettings], list[str]]:
    """The scenes of a run: of a labelled set, made-up rooms, and listed ones.

    And what is to be said of them.
    """
    labelled = any((settings.data, settings.pairs, settings.labels))
    scenes, said = labelled_scenes(settings) if labelled else ([], [])
    if settings.rooms is not None:
        scenes = [*scenes, *map(room_scene, seeds(settings.rooms, "rooms"))]
    scenes = [*scenes, *settings.scenes]
    if not scenes:
        raise InputError("nothing to do: give [[scenes]], or data and pairs, or rooms")
    names = [scene.name for scene in scenes]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two scenes are called {name!r}; names must be unique")
    return scenes, said


def plan(method: Method, scene: SceneSettings, name: str = "slgaussian") -> list[Step]:
    """The steps of one scene, each with just the settings that its result depends on."""
    views = [*scene.context, *scene.targets]
    where = {} if scene.path is None else {"path": str(scene.path)}
    ingest = Step(
        "ingest",
        {
            "scene": scene.name,
            "format": scene.format,
            "options": scene.options,
            "context": scene.context,
            "targets": scene.targets,
            "size": scene.size or method.size,
            "near": scene.near or method.near,
            "far": scene.far or method.far,
            "files": {}
            if scene.path is None
            else file_hashes(scene.format, scene.path, views, scene.options),
        },
        where=where,
    )
    labels = {} if scene.labels is None else {"labels": str(scene.labels)}
    truth = Step(
        "truth",
        {
            "categories": scene.categories,
            "files": {} if scene.labels is None else _label_hashes(scene.labels, scene.targets),
        },
        {"sample": "ingest"},
        where=labels,
    )
    parts = method.identity
    own = method.part_settings()
    where = {part: places(table) for part, table in own.items()}
    of_encoder = where.get(method.encoder, {})
    of_masks = {
        part: place
        for part in (method.proposer, method.tracker)
        for place in where.get(part, {}).values()
    }
    base = {"sample": "ingest", "gaussians": "geometry"}
    known = {"sample": "ingest", "labels": "masks"}
    asked = {
        "method": name,
        "dataset": scene.dataset,
        "queries": scene.queries,
        "rules": method.rules(),
    }
    return [
        ingest,
        truth,
        Step(
            "geometry",
            _only(parts, "predictor"),
            {"sample": "ingest"},
            where=where.get(method.predictor, {}),
        ),
        Step(
            "masks",
            _only(parts, "proposer", "tracker", "replicas"),
            base,
            where=of_masks,
        ),
        Step(
            "supervision",
            _only(parts, "encoder", "codes", "seed"),
            {**base, **known},
            where=of_encoder,
        ),
        Step(
            "field",
            parts,
            {**base, **known, "bank": "supervision"},
            where=where.get(method.lifting, {}),
        ),
        Step("benchmark", asked, {**known, "truth": "truth", "field": "field"}, where=of_encoder),
    ]


def check_folder(out: Path) -> None:
    """Make the output folder; InputError now, not after the work, if it cannot be written."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomic(out / ".probe", b"")
        (out / ".probe").unlink()
    except OSError as error:
        raise InputError(
            f"{out}: cannot write there ({error.strerror}); choose another folder with -o"
        ) from error


def _write(out: Path, store: ArtifactStore, made: _Made, page: str | None) -> list[SceneResult]:
    """Write what people get; the results, without images, as there may be thousands."""
    write_atomic(out / "failures.parquet", encode_table(failures_table(made.failures)))
    results = []
    for ref in made.answers.values():
        arrays = store.get(ref)
        results.append(result_from_arrays(arrays, ref.meta["times"], with_images=False))
        write_predictions(results[-1].rows, predictions_of(arrays), out / "predictions")
    write_samples(results, out)
    if page is None:
        # That of an earlier run is not about these scenes.
        (out / "report.html").unlink(missing_ok=True)
    else:
        write_atomic(out / "report.html", page.encode())
    return results


@dataclass
class _Made:
    """What the flow made.

    ``answers`` are the results of each scene, ours by its name and then those of other methods;
    ``seconds`` those that the results took by stage when they were made, which for cached ones is
    long ago.
    """

    answers: dict[str, ArtifactRef]
    failures: list[Failure]
    seconds: dict[str, float]
    report: ArtifactRef | None = None


def _pipeline(
    settings: Settings, scenes: Sequence[SceneSettings], store: ArtifactStore, progress: Progress
) -> _Made:
    @flow(
        name="slgaussian",
        task_runner=ThreadPoolTaskRunner(max_workers=settings.workers),
        persist_result=False,
        validate_parameters=False,
    )
    def pipeline() -> _Made:
        with using(store):
            task = stage_task()
            chains = [
                Chain(scene.name, lambda scene=scene: plan(settings, scene, settings.method))
                for scene in scenes
            ]
            outcome = run_chains(task, chains, settings.workers, progress)
            others = rivals.chains(settings, scenes, outcome.refs)
            more = Outcome()
            if others:
                course = Progress(len(others), 1, verbose=progress.verbose)
                more = run_chains(task, others, settings.workers, course)
                course.summary()
            made = _gathered(scenes, outcome, more)
            if made.answers:
                page = run_chains(task, [_report_chain(settings, made)], 1, progress)
                made.failures += page.failures
                made.report = page.refs.get("all scenes", {}).get("report")
            return made

    return pipeline()


def _gathered(scenes: Sequence[SceneSettings], outcome: Outcome, more: Outcome) -> _Made:
    answers = {}
    for scene in scenes:
        if scene.name in outcome.refs:
            answers[scene.name] = outcome.refs[scene.name]["benchmark"]
        for name, refs in more.refs.items():
            if name.startswith(f"{scene.name}: "):
                answers[name] = refs[rivals.STAGE]
    seconds = {
        stage: sum(refs[stage].meta["seconds"] for refs in outcome.refs.values())
        for stage in STAGES
    }
    if more.refs:
        seconds[rivals.STAGE] = sum(r[rivals.STAGE].meta["seconds"] for r in more.refs.values())
    return _Made(answers, [*outcome.failures, *more.failures], seconds)


def _report_chain(settings: Settings, made: _Made) -> Chain:
    shown = settings.model_dump(mode="json", include=Method.model_fields.keys() | {"method"})
    manifest = {
        "versions": {name: _version(name) for name in ("slgaussian", "torch", "numpy", "numba")},
        "settings": {name: shown[name] for name in shown if name not in TABLES} | settings.identity,
    }
    step = Step(
        "report",
        {
            "answers": list(made.answers),
            "manifest": manifest,
            "failures": [asdict(failure) for failure in made.failures],
        },
        {name: name for name in made.answers},
    )
    return Chain("all scenes", lambda: [step], dict(made.answers), first="report")


def _label_hashes(folder: Path, targets: Sequence[str]) -> dict[str, str]:
    files = [file for target in targets for file in label_files(folder, target)]
    return {
        file.relative_to(folder).as_posix(): sha256_of(file) for file in files if file.is_file()
    }


def _only(settings: dict[str, Any], *names: str) -> dict[str, Any]:
    """The named settings, and the tables of those parts that they name."""
    tables = [settings[name] for name in names if settings[name] in settings]
    return {name: settings[name] for name in (*names, *tables)}


def _version(package: str) -> str:
    return __version__ if package == "slgaussian" else version(package)
