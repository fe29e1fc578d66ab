"""Training of the semantic branch on the lessons of a corpus, with held-out evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from prefect import flow
from prefect.states import State

from flows.config import Training, TrainSettings
from flows.runners.batches import SceneTask, compute_scene
from flows.runners.progress import Progress
from flows.runners.session import check_folder, final_state, run_session, writing
from slgaussian import __version__
from slgaussian.datasets.scene_grouping import Places
from slgaussian.errors import InputError, SpecError
from slgaussian.io import write_atomic
from slgaussian.kernels.seeding import held_out
from slgaussian.semantic.branch import Architecture, load_branch, save_branch
from slgaussian.semantic.configs import TrainingConfig
from slgaussian.semantic.training import TrainingSettings, find_device
from slgaussian.semantic.versions import find_weights
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.training import branch_from_arrays, judge, training_report
from tasks.training import train as train_stage

FILES = {
    "weights": "branch.safetensors",
    "metrics": "metrics.parquet",
    "judgements": "judgements.parquet",
    "report": "report.html",
}
"""Output files of a training."""

LOSS_TAIL = 20
"""The loss in the metadata of weights is the mean over the last 1/LAST of the steps."""

CHECKPOINT_STEPS = 20
"""Steps between checkpoints: these steps take seconds, a checkpoint hundredths of a second."""


@dataclass(frozen=True, eq=False)
class Parted:
    """Tables of training lessons and of held-out lessons, spec ``lessons``."""

    learnt: pa.Table
    held_out: pa.Table

    def counts(self) -> dict[str, int]:
        """Return the numbers of lessons and clips of both."""
        return {
            f"{name} {kind}": count
            for name, table in vars(self).items()
            for kind, count in (
                ("lessons", table.num_rows),
                ("clips", len(set(table["clip"].to_pylist()))),
            )
        }


@dataclass(frozen=True, eq=False)
class Trained:
    """Result of a training: weights as a safetensors file, metrics, scores and report."""

    weights: bytes
    metrics: pa.Table
    judgements: pa.Table
    report: bytes

    def write(self, out: Path) -> None:
        """Write the :data:`FILES`; InputError if that fails."""
        contents = {
            "weights": self.weights,
            "metrics": encode_table(self.metrics, load_spec("metrics")),
            "judgements": encode_table(self.judgements, load_spec("judgements")),
            "report": self.report,
        }
        with writing(out):
            for name, data in contents.items():
                write_atomic(out / FILES[name], data)


@flow(name="slgaussian-train", flow_run_name="train {config.out.name}", persist_result=False)
def train_branch(config: TrainSettings, verbose: bool = False) -> State[Trained]:
    """Train the semantic branch on the lessons in a folder; write weights, tables and report.

    Raises:
        InputError: If there are too few lessons, they are not in the store, the initial weights
            cannot be used, the training fails, or a file cannot be written.
    """
    trained = run_session("train", config, lambda store: _train(config, store, verbose))
    return final_state(f"weights: {config.out / FILES['weights']}", trained)


def _train(config: TrainSettings, store: ArtifactStore, verbose: bool) -> Trained:
    table = read_lessons(config.lessons / "lessons.parquet", store)
    lessons = parted(table, config.held_out, read_places(config.lessons / "views.parquet"))
    start = None if config.start is None else find_weights(config.start)
    store.check_writable()
    check_folder(config.out)
    trained = train_on(lessons, config, config.codes, config.seed, start, store, verbose)
    trained.write(config.out)
    return trained


def read_lessons(file: Path, store: ArtifactStore) -> pa.Table:
    """Read the table of `supervise`; InputError if it or its lessons are missing."""
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(
            f"{file}: cannot be read ({error.strerror}); expected a table of `slgaussian supervise`"
        ) from error
    spec = load_spec("lessons")
    table = decode_table(data, spec, str(file), "run `slgaussian supervise` again")
    try:
        for uri in table["uri"].to_pylist()[:1]:
            store.check_exists(uri)
    except SpecError as error:
        raise InputError(
            f"{file}: its lessons are not in the store {store.root}; give the --store of "
            "`slgaussian supervise`"
        ) from error
    return table


def read_places(file: Path) -> dict[str, str]:
    """Read the places of the clips in a table of spec ``views``, of those of near copies one.

    There are none if the file is missing.
    """
    if not file.is_file():
        return {}
    table = decode_table(
        file.read_bytes(), load_spec("views"), str(file), "run `slgaussian supervise` again"
    )
    places = Places()
    for clip, rows in groupby(
        table.select(["clip", "digest", "signature"]).to_pylist(), key=lambda row: row["clip"]
    ):
        frames = list(rows)
        digests, signatures = ([row[key] for row in frames] for key in ("digest", "signature"))
        places.add(clip, digests, signatures=signatures)
    return places.by_clip()


def parted(lessons: pa.Table, share: float, places: Mapping[str, str] | None = None) -> Parted:
    """Split lessons into those of training clips and of :func:`held-out <held_out>` clips.

    Clips of one place are on one side. Their order does not depend on the chunks.

    Raises:
        InputError: If one of them is empty.
    """
    schema = load_spec("lessons").schema
    sides: tuple[list[dict[str, Any]], ...] = [], []
    for row in lessons.sort_by("sample").to_pylist():
        place = (places or {}).get(row["clip"], row["clip"])
        sides[held_out(place, share)].append({**row, "chunk": None})
    result = Parted(*(pa.Table.from_pylist(side, schema=schema) for side in sides))
    counts = result.counts()
    if not all(counts.values()):
        raise InputError(
            f"held_out {share:g}: found {counts['learnt clips']} training clips and "
            f"{counts['held_out clips']} held-out clips with lessons, expected at least one of "
            "each; give more clips, or another fraction"
        )
    return result


def train_on(
    lessons: Parted,
    options: Training,
    codes: str,
    seed: int,
    start: Path | None,
    store: ArtifactStore,
    verbose: bool,
) -> Trained:
    """Train from the weights ``start``, or random ones; evaluate and report.

    The weights ``start`` are evaluated too, as ``before``. Stages that were computed before are
    read from the store, and an interrupted training is resumed. The metadata of the weights
    describe their training data and scores.
    """
    find_device(options.device)
    architecture, began = Architecture(), None
    if start is not None:
        architecture = load_branch(start).architecture
        began = store.put("weights", {"safetensors": np.fromfile(start, np.uint8)})
    chosen = options.model_dump(include={"widths", "hidden"}, exclude_none=True)
    settings = TrainingSettings(
        **dict(TrainingConfig.of(options)),
        architecture=replace(architecture, **chosen),
        codes=codes,
        seed=seed,
        every=CHECKPOINT_STEPS,
    )
    manifest = {
        **lessons.counts(),
        "start": "weights" if began else "seeded",
        "settings": settings.model_dump(),
        "versions": {"slgaussian": __version__, "torch": version("torch")},
    }
    tables = [store.put("lessons", table) for table in vars(lessons).values()]
    task = SceneTask("branch", learn_and_judge, (*tables, began, settings, manifest))
    with Progress(1, len(STAGES), verbose=verbose) as progress:
        artifacts, failure = compute_scene(task, store, 1, progress.update)
    if failure is not None:
        raise InputError(failure.reason)
    course = ArtifactRef("metrics", **artifacts["train"].meta["metrics"])
    metrics, judgements = store.get(course), store.get(artifacts["judge"])
    statement = {
        "data": {"lessons": tables[0].digest, "held_out": tables[1].digest},
        **manifest,
        "metrics": _metrics(metrics, judgements),
    }
    return Trained(
        save_branch(branch_from_arrays(store.get(artifacts["train"])), statement),
        metrics,
        judgements,
        store.get(artifacts["training_report"])["html"].tobytes(),
    )


def _metrics(course: pa.Table, judgements: pa.Table) -> dict[str, Any]:
    """Return the mean loss of the last steps, and the IoU by lifting."""
    last = course["loss"].to_numpy()[-max(1, course.num_rows // LOSS_TAIL) :]
    means = judgements.group_by("lifting").aggregate([("iou", "mean")]).sort_by("lifting")
    iou = dict(zip(means["lifting"].to_pylist(), means["iou_mean"].to_pylist(), strict=True))
    return {"loss": float(last.mean()), "held out iou": iou}


STAGES = (train_stage, judge, training_report)


def learn_and_judge(
    learnt: ArtifactRef,
    held_out: ArtifactRef,
    start: ArtifactRef | None,
    settings: TrainingSettings,
    manifest: Mapping[str, Any],
) -> None:
    """Run the stages of a training: train, evaluate on held-out lessons, report."""
    branch = train_stage(learnt, start, settings)
    judgements = judge(held_out, branch, start, settings.codes, settings.seed)
    training_report(judgements, branch, manifest)
