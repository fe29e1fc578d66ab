"""The main job: photographs of many scenes in; fields, scores and a report out."""

from __future__ import annotations

import json
import os
import platform
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa

from flows import baselines, kept
from flows.labelled import labelled_scenes
from flows.manifest import manifest
from flows.room_scenes import room_scene, seeds
from flows.runners.progress import Progress
from flows.runners.worker_pool import Crew, Outcome, failures_table, run_chains, run_flow
from flows.settings import Method, SceneSettings, Settings
from slgaussian.benchmark.annotations import label_files
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.benchmark.outputs import (
    clear_predictions,
    write_predictions,
    write_samples,
    write_table,
)
from slgaussian.benchmark.report import Report, with_times
from slgaussian.benchmark.timings import Times
from slgaussian.build import check_parts
from slgaussian.errors import InputError
from slgaussian.language.query import Rules
from slgaussian.parts.identity import places
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import (
    ArtifactRef,
    ArtifactStore,
    encode_table,
    sha256_of,
    write_atomic,
)
from tasks.artifacts import predictions_of, result_from_arrays
from tasks.ingest import file_hashes
from tasks.shard import Chain, Failure, Step, given

STAGES = (
    "ingest",
    "truth",
    "geometry",
    "masks",
    "supervision",
    "field",
    "benchmark",
    "attribution",
)

LEFT = ("manifest.json", "pairs.json", "report.html", "report.md", "times.json")
"""Files that a run leaves beside its tables and masks, or takes away if it has none of its own."""


@dataclass(frozen=True)
class Finished:
    """What a run leaves: results in the order of the scenes, ours first in each, who was left out,
    and ``ready``, a command that asks the field of one of the scenes; empty if none has a field."""

    results: list[SceneResult]
    failures: list[Failure]
    report: Path | None
    ready: str


def run(settings: Settings, store: ArtifactStore, verbose: bool = False) -> Finished:
    """Run the pipeline; write its tables, masks, fields and report to ``settings.out``.

    Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

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
    baselines.chosen(settings.against)
    store.check_writable()
    check_folder(settings.out)
    kept.check_places([scene.name for scene in scenes], settings.out)
    progress = Progress(len(scenes), len(STAGES), verbose=verbose)
    for text in (f"with {', '.join(parts.values())}", *said):
        progress.line(text)
    made = _pipeline(settings, scenes, store, progress)
    try:
        results = _write(settings, store, made, progress.line)
    except OSError as error:
        raise InputError(
            f"{settings.out}: cannot write the results ({error.strerror}); they are kept in the "
            "store, so make room there, or choose another folder with -o, and run again"
        ) from error
    progress.summary()
    written = None if made.report is None else settings.out / "report.html"
    return Finished(results, made.failures, written, _ready(made, settings.out))


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
    parts, trusted = method.identity, method.trust_cameras
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
    asked = {"method": name, "dataset": scene.dataset, "rules": method.rules()}
    answered = {**known, "truth": "truth", "field": "field"}
    of_proposer = where.get(method.proposer, {}).items()
    of_attribution = {f"{method.proposer}.{key}": place for key, place in of_proposer}
    return [
        ingest,
        truth,
        Step(
            "geometry",
            # What a check lets pass is the same with it and without.
            {**_only(parts, "predictor", "seed"), **({"trust_cameras": True} if trusted else {})},
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
        Step("benchmark", {**asked, **scene.asked}, answered, where=of_encoder),
        Step("attribution", asked, answered, where={**of_encoder, **of_attribution}),
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


def _write(
    settings: Settings, store: ArtifactStore, made: _Made, tell: Callable[[str], None]
) -> list[SceneResult]:
    """Write what people get; the results, without images, as there may be thousands."""
    out = settings.out
    write_atomic(out / "failures.parquet", encode_table(failures_table(made.failures)))
    results, times = [], []
    for scene, ref in made.results():
        arrays = store.get(ref)
        result = result_from_arrays(arrays, ref.meta["times"], with_images=False)
        write_predictions(result.rows, predictions_of(arrays), out / "predictions")
        results.append(result)
        times.append((result.method, scene, result.times))
    rows = [row for result in results for row in result.rows]
    clear_predictions(rows, out)
    write_samples(rows, out)
    lost = [
        load_spec("attribution").schema.empty_table(),
        *map(store.get, made.attributions.values()),
    ]
    write_table("attribution", pa.concat_tables(lost), out)
    files = {"manifest.json": _json(made.manifest)}
    if settings.pairs is not None:
        files["pairs.json"] = settings.pairs.read_bytes()
    if made.report is not None:
        host = {
            "machine": platform.platform(),
            "processors": str(os.cpu_count()),
            "workers": str(settings.workers),
        }
        took = Times(made.seconds, times, host)
        stored = store.get(made.report)
        forms = (stored[form].tobytes().decode() for form in ("html", "markdown"))
        report = with_times(Report(*forms), took)
        files["report.html"], files["report.md"] = report.html.encode(), report.markdown.encode()
        files["times.json"] = _json(took.as_json())
    for name in LEFT:
        if name in files:
            write_atomic(out / name, files[name])
        else:
            # That of an earlier run is not about these scenes.
            (out / name).unlink(missing_ok=True)
    of_encoder = places(settings.part_settings().get(settings.encoder, {}))
    kept.write_fields(store, made.fields, of_encoder, out, tell)
    return results


def _ready(made: _Made, out: Path) -> str:
    """A command that asks a field something, as it can be pasted.

    Of the first scene whose answer is known to be right, or else of the first that has one. A field
    without is drawn.
    """
    asked = {scene: ref.meta["example"] for scene, ref in made.answers.items()}
    examples = {scene: example for scene, example in asked.items() if example is not None}
    known = [scene for scene, example in examples.items() if example["iou"] is not None]
    scene = next(iter([*known, *examples, *made.fields]), None)
    if scene is None:
        return ""
    folder = kept.place(scene, out)
    with suppress(ValueError):  # it is not below the working folder
        folder = folder.relative_to(Path.cwd())
    if scene not in examples:
        return shlex.join(["slgaussian", "render", str(folder), "-o", "picture.png"])
    text = examples[scene]["text"]
    return shlex.join(["slgaussian", "query", str(folder), text, "-o", "hit.png"])


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


@dataclass
class _Made:
    """What the flow made.

    By scene: ``fields`` are those of all scenes that came so far, ``answers`` our results,
    ``others`` by method those of other methods, ``truths`` what they were scored against, and
    ``attributions`` what lost ours. ``seconds`` are those that all took by stage when they were
    made, which for cached ones is long ago.
    """

    fields: dict[str, ArtifactRef]

    answers: dict[str, ArtifactRef]
    others: dict[str, dict[str, ArtifactRef]]
    truths: dict[str, ArtifactRef]
    attributions: dict[str, ArtifactRef]
    failures: list[Failure]
    seconds: dict[str, float]
    manifest: dict[str, Any]
    report: ArtifactRef | None = None

    def results(self) -> Iterator[tuple[str, ArtifactRef]]:
        """All results with their scene, ours first in each."""
        for scene, ref in self.answers.items():
            yield scene, ref
            for other in self.others[scene].values():
                yield scene, other


def _pipeline(
    settings: Settings, scenes: Sequence[SceneSettings], store: ArtifactStore, progress: Progress
) -> _Made:
    def work(crew: Crew) -> _Made:
        chains = [Chain(scene.name, partial(_planned, settings, scene)) for scene in scenes]
        with progress:
            outcome = run_chains(chains, crew, progress)
        others = baselines.chains(settings, scenes, outcome.refs)
        more = Outcome()
        if others:
            with Progress(len(others), 1, progress.verbose, unit="answers") as course:
                more = run_chains(others, crew, course)
            course.summary()
        made = _gathered(settings, scenes, outcome, more)
        if made.answers:
            with Progress(1, 1, progress.verbose, unit="reports") as course:
                page = run_chains([_report_chain(made)], crew, course)
            made.failures += page.failures
            made.report = page.refs.get("all scenes", {}).get("report")
        return made

    return run_flow("slgaussian", work, store, settings.runner, settings.workers)


def _planned(settings: Settings, scene: SceneSettings, store: ArtifactStore) -> list[Step]:
    return plan(settings, scene, settings.method)


def _gathered(
    settings: Settings, scenes: Sequence[SceneSettings], outcome: Outcome, more: Outcome
) -> _Made:
    through = [scene.name for scene in scenes if scene.name in outcome.refs]
    rows = baselines.chosen(settings.against)
    others = {
        scene: {
            method: more.refs[chain][baselines.STAGE]
            for method in rows
            if (chain := baselines.chain_name(scene, method)) in more.refs
        }
        for scene in through
    }
    seconds = {
        stage: sum(refs[stage].meta["seconds"] for refs in outcome.refs.values())
        for stage in STAGES
    }
    stages = [*STAGES, "report"]
    if rows:
        own = (ref.meta["seconds"] for by_method in others.values() for ref in by_method.values())
        seconds[baselines.STAGE] = sum(own)
        stages.append(baselines.STAGE)
    begun = outcome.begun | outcome.refs
    fields = {
        scene.name: begun[scene.name]["field"]
        for scene in scenes
        if "field" in begun.get(scene.name, {})
    }
    return _Made(
        fields,
        {scene: outcome.refs[scene]["benchmark"] for scene in through},
        others,
        {scene: outcome.refs[scene]["truth"] for scene in through},
        {scene: outcome.refs[scene]["attribution"] for scene in through},
        [*outcome.failures, *more.failures],
        seconds,
        manifest(settings, scenes, stages, outcome.refs, rows),
    )


def _report_chain(made: _Made) -> Chain:
    inputs: dict[str, ArtifactRef] = {}
    entries = []
    for k, (scene, answer) in enumerate(made.answers.items()):
        names = {method: f"{k} {method}" for method in made.others[scene]}
        own = {
            "answer": answer,
            "truth": made.truths[scene],
            "attribution": made.attributions[scene],
        }
        entry = {role: f"{k} {role}" for role in own}
        entries.append({"scene": scene, **entry, "others": names})
        inputs |= {entry[role]: ref for role, ref in own.items()}
        inputs |= {names[method]: ref for method, ref in made.others[scene].items()}
    step = Step(
        "report",
        {
            "scenes": entries,
            "manifest": made.manifest,
            "failures": [asdict(failure) for failure in made.failures],
        },
        {name: name for name in inputs},
    )
    return Chain("all scenes", partial(given, [step]), inputs, first="report")


def _label_hashes(folder: Path, targets: Sequence[str]) -> dict[str, str]:
    files = [file for target in targets for file in label_files(folder, target)]
    return {
        file.relative_to(folder).as_posix(): sha256_of(file) for file in files if file.is_file()
    }


def _only(settings: dict[str, Any], *names: str) -> dict[str, Any]:
    """The named settings, and the tables of those parts that they name."""
    tables = [settings[name] for name in names if settings[name] in settings]
    return {name: settings[name] for name in (*names, *tables)}
