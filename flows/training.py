"""Training of the semantic branch on the lessons of a corpus, with held-out evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from prefect import flow
from prefect.states import State

from flows.config import RetrainSettings, TrainSettings
from flows.runners.batches import SceneTask, compute_scene, state_after
from flows.runners.progress import Progress
from flows.runners.session import check_folder, final, run_session, writing
from slgaussian import __version__
from slgaussian.datasets.leaks import check_views
from slgaussian.datasets.scene_grouping import Places, read_views
from slgaussian.datasets.splits import TEST, TRAIN, Split, assign_split, read_split
from slgaussian.errors import InputError, SpecError
from slgaussian.io import write_atomic
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
    """Tables of training lessons and of held-out lessons, spec ``lessons``, and their split."""

    learnt: pa.Table
    held_out: pa.Table
    split: Split

    def tables(self) -> dict[str, pa.Table]:
        """Return both tables by name."""
        return {"learnt": self.learnt, "held_out": self.held_out}

    def counts(self) -> dict[str, int]:
        """Return the numbers of lessons and clips of both."""
        counts = {}
        for name, table in self.tables().items():
            counts[f"{name} lessons"] = table.num_rows
            counts[f"{name} clips"] = len(table["clip"].unique())
        return counts


@dataclass(frozen=True, eq=False)
class Trained:
    """Result of a training: weights as a safetensors file, tables, report; the split as text."""

    weights: bytes
    metrics: pa.Table
    judgements: pa.Table
    report: bytes
    split: str

    def write(self, out: Path) -> None:
        """Write the :data:`FILES`; InputError if that fails."""
        tables = {"metrics": self.metrics, "judgements": self.judgements}
        contents = {name: encode_table(table, load_spec(name)) for name, table in tables.items()}
        contents |= {"weights": self.weights, "report": self.report}
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
    trained = run_session("train", config, _train, verbose)
    message = f"weights: {config.out / FILES['weights']}"
    return final(state_after(message, trained, (), nothing_left=False))


def _train(config: TrainSettings, store: ArtifactStore, verbose: bool) -> Trained:
    table = read_lessons(config.lessons / "lessons.parquet", store)
    start = None if config.start is None else find_weights(config.start)
    store.check_writable()
    check_folder(config.out)
    folders, views = [config.lessons], config.lessons / "views.parquet"
    if config.start is not None:  # what these weights have learnt
        folders.append(config.start if config.start.is_dir() else config.start.parent)
    recorded = read_split(*folders)
    lessons = part_lessons(table, views, config.held_out, recorded, config.lessons)
    trained = train_on(lessons, config, start, store, verbose)
    trained.write(config.out)
    with writing(config.out):
        lessons.split.write(config.out)  # for trainings that start from these weights
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


def part_lessons(
    lessons: pa.Table,
    views: Path,
    fraction: float,
    recorded: Sequence[Mapping[str, Any]],
    folder: Path,
) -> Parted:
    """Split lessons by the places of their clips; write ``places.parquet`` to a folder.

    What was learnt before never judges (:func:`slgaussian.datasets.splits.assign_split`). The order
    of the lessons does not depend on the chunks.

    Args:
        lessons: Spec ``lessons``.
        views: Table of spec ``views`` of the clips.
        fraction: Expected fraction of held-out places.
        recorded: Rows of spec ``places`` from before.
        folder: It is made if it is missing.

    Raises:
        InputError: If a side is empty, the views are missing, the split leaks, or the folder cannot
            be written.
    """
    places = Places()
    places.add_views(read_views(views))
    split = assign_split(places, set(lessons["clip"].to_pylist()), fraction, recorded, TRAIN)
    rows: dict[str, list[dict[str, Any]]] = {TRAIN: [], TEST: []}
    for row in lessons.sort_by("sample").to_pylist():
        if row["clip"] in split.sides:
            rows[split.sides[row["clip"]]].append({**row, "chunk": None})
    schema = load_spec("lessons").schema
    learnt, held_out = (pa.Table.from_pylist(side, schema=schema) for side in rows.values())
    result = Parted(learnt, held_out, split)
    counts = result.counts()
    if not all(counts.values()):
        raise InputError(
            f"held_out {fraction:g}: found {counts['learnt clips']} training clips and "
            f"{counts['held_out clips']} held-out clips with lessons, expected at least one of "
            f"each; give clips of more places. {split.summary}"
        )
    check_views(read_views(views), split.sides, views)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        split.write(folder)
    return result


def train_on(
    lessons: Parted,
    options: TrainSettings | RetrainSettings,
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
        codes=options.codes,
        seed=options.seed,
        every=CHECKPOINT_STEPS,
    )
    manifest = {
        **lessons.counts(),
        "start": "weights" if began else "seeded",
        "settings": settings.model_dump(),
        "versions": {"slgaussian": __version__, "torch": version("torch")},
    }
    tables = [store.put("lessons", table) for table in lessons.tables().values()]
    task = SceneTask("branch", learn_and_judge, (*tables, began, settings, manifest))
    with Progress(1, len(STAGES), verbose=verbose) as progress:
        result = compute_scene(task, store, 1, progress.update)
    if result.failure is not None:
        raise InputError(result.failure.reason)
    artifacts = result.refs
    course = ArtifactRef("metrics", **artifacts["train"].meta["metrics"])
    metrics, judgements = store.get(course), store.get(artifacts["judge"])
    last = metrics["loss"].to_numpy()[-max(1, metrics.num_rows // LOSS_TAIL) :]
    means = judgements.group_by("lifting").aggregate([("iou", "mean")]).sort_by("lifting")
    iou = dict(zip(means["lifting"].to_pylist(), means["iou_mean"].to_pylist(), strict=True))
    statement = {
        "data": {"lessons": tables[0].digest, "held_out": tables[1].digest},
        **manifest,
        "metrics": {"loss": float(last.mean()), "held out iou": iou},
    }
    return Trained(
        save_branch(branch_from_arrays(store.get(artifacts["train"])), statement),
        metrics,
        judgements,
        store.get(artifacts["training_report"])["html"].tobytes(),
        lessons.split.summary,
    )


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
