"""Retraining on a growing corpus: train, evaluate, and promote the weights if they are better.

The flow is used by the command line and by deployments (``prefect.yaml``).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from prefect import flow
from prefect.client.schemas.objects import StateType
from prefect.states import State

from flows import corpus
from flows.config import RetrainSettings, Training
from flows.runners.session import check_folder, final, publish, run_session, writing
from flows.training import FILES, part_lessons, read_lessons, train_on
from slgaussian.benchmark.reports.model import append_section, data_uri
from slgaussian.benchmark.reports.training import history_plot, history_section
from slgaussian.benchmark.retrainings import History, count_lessons, score_columns, summaries
from slgaussian.benchmark.significance import clip_scores, gain, gate, regression
from slgaussian.datasets.splits import FILE as PLACES
from slgaussian.datasets.splits import Split, read_split
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.io import write_atomic
from slgaussian.semantic.versions import Version, Versions, mark_clip, version_name
from slgaussian.storage.encoding import table_digest
from slgaussian.storage.locks import BusyError, hold_lock
from slgaussian.storage.store import ArtifactStore
from slgaussian.storage.tables import read_table

TRAINING_SETTINGS = (*Training.model_fields, "codes", "seed")
"""Settings whose change requires a new training."""

STATUS = {"promoted": 0, "failed": 2, "refused": 3, "regressed": 4, "busy": 5, "nothing new": 6}
"""Exit status of the command by the outcome."""

STATE_TYPES = {
    "promoted": StateType.COMPLETED,
    "nothing new": StateType.COMPLETED,
    "refused": StateType.FAILED,
    "regressed": StateType.FAILED,
    "busy": StateType.CANCELLED,
}
"""Type of the final state by the outcome."""

LOCK = ".retrain.lock"

PLOT = "history.png"
"""Plot of the history in the folder of versions."""

ARTIFACT, HISTORY, PAGE = "slgaussian-retraining", "slgaussian-history", "slgaussian-training"
"""Keys of the Prefect artifacts of retrainings."""

NO_NETWORK = {"hard": "no network (hard)", "filled": "no network (filled)"}
"""Liftings without weights. A branch that is worse than one of them is useless."""


@dataclass(frozen=True)
class Retraining:
    """Result of a retraining.

    Attributes:
        outcome: One of :data:`STATUS`.
        messages: tuple of str
    """

    outcome: str
    messages: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Learnt:
    """Result of :func:`learn`.

    Attributes:
        message: Summary in a sentence.
        version: The added version; None if nothing was new.
        split: Sides of the clips.
        regressed: A message if the version in use before is worse than no network on the held-out
            lessons; else empty.
    """

    message: str
    version: Version | None
    split: Split
    regressed: str = ""


@flow(name="slgaussian-retrain", flow_run_name="retrain {config.models.name}", persist_result=False)
def retrain(config: RetrainSettings, verbose: bool = False) -> State[Retraining]:
    """Ingest and label new clips, train, evaluate, and promote the weights if they are better.

    The name of the final state is the outcome, for Prefect's automations: ``Promoted`` and
    ``NothingNew`` are of type Completed, ``Refused`` and ``Regressed`` of type Failed, ``Busy`` of
    type Cancelled; an error fails the run. The history in the folder of versions and Prefect
    artifacts have the scores, the decision and what was left out.

    Raises:
        InputError: As in :func:`flows.corpus.supervise` and :func:`learn`, after it was recorded.
    """
    check_folder(config.out)
    try:
        with hold_lock(config.out / LOCK, "retrain"), hold_lock(config.models / LOCK, "retrain"):
            result = run_session("retrain", config, _retrain, verbose)
    except BusyError as error:
        result = Retraining("busy", (str(error),))
    type, name = STATE_TYPES[result.outcome], result.outcome.title().replace(" ", "")
    return final(State(type=type, name=name, message="; ".join(result.messages), data=result))


def _retrain(config: RetrainSettings, store: ArtifactStore, verbose: bool) -> Retraining:
    start, row, messages = time.perf_counter(), dict[str, Any](), list[str]()
    history = History(config.models)
    try:
        failures = corpus.supervise(config, store, verbose).failures
        lessons = read_lessons(config.out / corpus.FILES["lessons"], store)
        learnt = learn(lessons, config, store, verbose)
        row |= count_lessons(lessons, learnt.split.places) | {"split": learnt.split.digest}
        version, used = learnt.version, Versions(config.models).current()
        outcome, messages = "nothing new", [learnt.message]
        if version is not None:
            outcome = "promoted" if version.promoted else "refused"
            row["version"] = version.number
            row |= score_columns(read_table(config.out / FILES["judgements"]))
            pairs = config.out / corpus.FILES["pairs"]
            row |= history.compare_lessons(lessons, pairs, version.number)
        messages.append(learnt.split.summary)
        if learnt.regressed:
            outcome = "regressed"
            end = f"`slgaussian versions {config.models} --use none` ends it"
            messages.append(f"{learnt.regressed}; {end}")
        if failures:
            first = failures[0]
            messages.append(f"left out: {len(failures)}, as {first.scene}: {first.reason}")
        row |= {"in_use": 0 if used is None else used.number, "outcome": outcome}
    except Exception as error:
        expected = isinstance(error, SLGaussianError)
        messages = [str(error) if expected else f"unexpected {type(error).__name__}: {error}"]
        row["outcome"] = "failed"
        raise
    finally:
        if "outcome" in row:  # not after a signal
            row |= {"reason": "; ".join(messages), "seconds": time.perf_counter() - start}
            with writing(config.models):
                history.add(row)
                _report(history.table, config, row, messages)
    return Retraining(row["outcome"], tuple(messages))


def _report(
    history: pa.Table, config: RetrainSettings, row: Mapping[str, Any], messages: Sequence[str]
) -> None:
    """Write the plot of the history, add it to the page of the training, publish both."""
    plot = history_plot(history)
    write_atomic(config.models / PLOT, plot)
    section = history_section(history, plot)
    if "version" in row:
        page = config.out / FILES["report"]
        text = append_section(page.read_text("utf-8"), "html", section)
        write_atomic(page, text.encode())
        publish(PAGE, page, "Report of the training, with the history")
    picture = f"![IoU by version]({data_uri(plot, 'png')})"
    text = "\n\n".join([f"# Retraining: {row['outcome']}", *messages, picture])
    publish(ARTIFACT, append_section(text, "md", section), "Outcome, reasons and history")
    publish(HISTORY, summaries(history), "Retrainings, the latest first")


def learn(
    table: pa.Table, settings: RetrainSettings, store: ArtifactStore, verbose: bool = False
) -> Learnt:
    """Train on lessons from the weights in use, and promote the result if it is better.

    The candidate, the version in use, ``hard`` and ``filled`` are evaluated on the same held-out
    lessons. The candidate is promoted if it is significantly better than all others
    (:func:`slgaussian.benchmark.significance.gate`), and stored in any case. If lessons and
    settings are unchanged, nothing is trained. The sides of clips are in the folder of versions.

    Raises:
        InputError: As in :func:`flows.training.part_lessons` and :func:`flows.training.train_on`;
            or if a folder cannot be written, or lacks the sides of clips that were learnt.
    """
    versions = Versions(settings.models)
    history, incumbent = versions.all(), versions.current()
    recorded = read_split(settings.models)
    if incumbent is not None and not recorded:
        raise InputError(
            f"{settings.models}: found no {PLACES}, expected the sides of the clips that "
            f"{version_name(incumbent.number)} has learnt; restore it, or choose another folder"
        )
    views = settings.out / corpus.FILES["views"]
    lessons = part_lessons(table, views, settings.held_out, recorded, settings.models)
    split = lessons.split
    requested = settings.model_dump(mode="json", include=set(TRAINING_SETTINGS))
    requested["lessons"] = {name: table_digest(side) for name, side in lessons.tables().items()}
    used = version_name(0 if incumbent is None else incumbent.number)
    if history and requested == history[-1].facts.get("asked"):
        message = f"nothing new since version {history[-1].number}; {used} is in use"
        return Learnt(message, None, split)
    start, rivals = None, NO_NETWORK
    if incumbent is not None:
        start, rivals = versions.weights(incumbent), {"before": used, **NO_NETWORK}
    trained = train_on(lessons, settings, start, store, verbose)
    trained.write(settings.out)
    judgements = trained.judgements
    decision = gate(judgements, rivals)
    means = {name: float(np.mean(scores)) for name, scores in clip_scores(judgements).items()}
    scores = {"iou": means, "over hard": vars(gain(judgements, "hard"))}
    learnt_clips = sorted(map(mark_clip, lessons.learnt["clip"].unique().to_pylist()))
    facts: dict[str, Any] = {"asked": requested, "counts": lessons.counts(), "scores": scores}
    facts |= {"learnt_clips": learnt_clips, "split": split.digest}
    added = versions.add(trained.weights, facts, decision.better, decision.reason, incumbent)
    if added.promoted:
        return Learnt(f"version {added.number} promoted: {added.why}", added, split)
    regressed = regression(judgements, NO_NETWORK, rivals.get("before", ""))
    message = f"version {added.number} stored, not promoted: {added.why}"
    return Learnt(message, added, split, regressed)
