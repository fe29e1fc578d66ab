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

from flows.chains import Chain, Failure, Outcome, Step, failures_table, run_chains
from flows.progress import Progress
from flows.settings import TABLES, Method, SceneSettings, Settings
from slgaussian import __version__
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.labels import read_pairs
from slgaussian.benchmark.report import with_times, write_predictions, write_samples
from slgaussian.build import check_parts
from slgaussian.errors import InputError
from slgaussian.language.query import Rules
from slgaussian.parts import places
from slgaussian.store import ArtifactRef, ArtifactStore, encode_table, sha256_of, write_atomic
from tasks.artifacts import result_from_arrays
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
    scenes = scenes_of(settings)
    parts = settings.part_names()
    check_parts(**parts, settings=settings.part_settings())
    Rules(**settings.rules())
    store.check_writable()
    check_folder(settings.out)
    progress = Progress(len(scenes), len(STAGES), more=1, verbose=verbose)
    progress.line(f"with {', '.join(parts.values())}")
    outcome, report = _pipeline(settings, scenes, store, progress)
    done = [scene.name for scene in scenes if scene.name in outcome.refs]
    results = [load_result(store, outcome.refs[name]) for name in done]
    page = None
    if report is not None:
        page = with_times(
            store.get(report)["html"].tobytes().decode(),
            _seconds_by_stage(outcome),
            {result.scene: result.times for result in results},
            {"python": platform.python_version(), "machine": platform.platform()},
        )
    try:
        _write(settings.out, results, outcome.failures, page)
    except OSError as error:
        raise InputError(
            f"{settings.out}: cannot write the results ({error.strerror}); they are kept in the "
            "store, so make room there, or choose another folder with -o, and run again"
        ) from error
    progress.summary()
    written = None if page is None else settings.out / "report.html"
    return Finished(results, outcome.failures, written)


def scenes_of(settings: Settings) -> list[SceneSettings]:
    """The scenes of a run: as listed, or those of a labelled set."""
    if settings.pairs is None:
        if not settings.scenes:
            raise InputError("nothing to do: give [[scenes]], or data, pairs and labels")
        return settings.scenes
    if settings.data is None or settings.labels is None:
        raise InputError("a labelled set needs all of data, pairs and labels")
    return [
        SceneSettings(
            name=pair.scene,
            path=settings.data,
            context=list(pair.context),
            targets=list(pair.targets),
            labels=settings.labels,
            categories=list(pair.categories),
        )
        for pair in read_pairs(settings.pairs)
    ]


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
            "files": {} if scene.path is None else file_hashes(scene.path, views),
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
    asked = {"method": name, "queries": scene.queries, "rules": method.rules()}
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


def load_result(store: ArtifactStore, refs: dict[str, ArtifactRef]) -> SceneResult:
    """The benchmark result of a scene, without its pictures, from the refs of its stages."""
    ref = refs["benchmark"]
    return result_from_arrays(store.get(ref), ref.meta["times"], with_pictures=False)


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


def _write(
    out: Path, results: Sequence[SceneResult], failures: Sequence[Failure], page: str | None
) -> None:
    write_atomic(out / "failures.parquet", encode_table(failures_table(failures)))
    write_samples(results, out)
    write_predictions(results, out / "predictions")
    if page is None:
        # That of an earlier run is not about these scenes.
        (out / "report.html").unlink(missing_ok=True)
    else:
        write_atomic(out / "report.html", page.encode())


def _pipeline(
    settings: Settings, scenes: Sequence[SceneSettings], store: ArtifactStore, progress: Progress
) -> tuple[Outcome, ArtifactRef | None]:
    @flow(
        name="slgaussian",
        task_runner=ThreadPoolTaskRunner(max_workers=settings.workers),
        persist_result=False,
        validate_parameters=False,
    )
    def pipeline() -> tuple[Outcome, ArtifactRef | None]:
        with using(store):
            task = stage_task(store)
            chains = [
                Chain(scene.name, lambda scene=scene: plan(settings, scene, settings.method))
                for scene in scenes
            ]
            outcome = run_chains(task, chains, settings.workers, progress)
            if not outcome.refs:
                return outcome, None
            page = run_chains(task, [_report_chain(settings, scenes, outcome)], 1, progress)
            outcome.failures += page.failures
            made = page.refs.get("all scenes", {})
            return outcome, made.get("report")

    return pipeline()


def _report_chain(settings: Settings, scenes: Sequence[SceneSettings], outcome: Outcome) -> Chain:
    names = [scene.name for scene in scenes if scene.name in outcome.refs]
    refs = {name: outcome.refs[name]["benchmark"] for name in names}
    shown = settings.model_dump(mode="json", include=Method.model_fields.keys() | {"method"})
    manifest = {
        "versions": {name: _version(name) for name in ("slgaussian", "torch", "numpy", "numba")},
        "settings": {name: shown[name] for name in shown if name not in TABLES} | settings.identity,
    }
    step = Step(
        "report",
        {
            "scenes": names,
            "manifest": manifest,
            "failures": [asdict(failure) for failure in outcome.failures],
        },
        {name: name for name in names},
    )
    return Chain("all scenes", lambda: [step], refs, first="report")


def _seconds_by_stage(outcome: Outcome) -> dict[str, float]:
    """Seconds that the results took when they were made, which for cached ones is long ago."""
    return {
        stage: sum(refs[stage].meta["seconds"] for refs in outcome.refs.values())
        for stage in STAGES
    }


def _label_hashes(folder: Path, targets: Sequence[str]) -> dict[str, str]:
    files = [folder / f"{Path(target).stem}.json" for target in targets]
    return {file.name: sha256_of(file) for file in files if file.is_file()}


def _only(settings: dict[str, Any], *names: str) -> dict[str, Any]:
    """The named settings, and the tables of those parts that they name."""
    tables = [settings[name] for name in names if settings[name] in settings]
    return {name: settings[name] for name in (*names, *tables)}


def _version(package: str) -> str:
    return __version__ if package == "slgaussian" else version(package)
