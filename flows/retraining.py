"""Retraining on a growing corpus: train, evaluate, and promote the weights if they are better.

The flow is used by the command line and by deployments (``prefect.yaml``).
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from prefect import flow
from prefect.client.schemas.objects import StateType
from prefect.states import State

from flows import corpus
from flows.config import RetrainSettings, Training
from flows.runners.session import check_folder, final, publish, run_session
from flows.training import parted, read_lessons, read_places, train_on
from slgaussian.benchmark.significance import clip_scores, gain, gate, regression
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.io import write_atomic
from slgaussian.semantic.versions import Version, Versions, mark_clip, version_name
from slgaussian.storage.encoding import table_digest
from slgaussian.storage.locks import BusyError, hold_lock
from slgaussian.storage.store import ArtifactStore

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

RECORD = "retraining.json"
"""Record of the last retraining in the output folder."""

ARTIFACT = "slgaussian-retraining"
"""Key of the Prefect artifacts of retrainings."""

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
        regressed: A message if the version in use before is worse than no network on the held-out
            lessons; else empty.
    """

    message: str
    version: Version | None
    regressed: str = ""


@flow(name="slgaussian-retrain", persist_result=False)
def retrain(config: RetrainSettings, verbose: bool = False) -> State[Retraining]:
    """Ingest and label new clips, train, evaluate, and promote the weights if they are better.

    The name of the final state is the outcome, for Prefect's automations: ``Promoted`` and
    ``NothingNew`` are of type Completed, ``Refused`` and ``Regressed`` of type Failed, ``Busy`` of
    type Cancelled; an error fails the run. A record and a Prefect artifact have the scores, the
    decision and what was left out.

    Raises:
        InputError: As in :func:`flows.corpus.supervise` and :func:`learn`, after it was recorded.
    """
    check_folder(config.out)
    try:
        with hold_lock(config.out / LOCK, "retrain"), hold_lock(config.models / LOCK, "retrain"):
            (config.out / RECORD).unlink(missing_ok=True)  # if interrupted, there is none
            result = run_session("retrain", config, lambda store: _retrain(config, store, verbose))
    except BusyError as error:
        result = Retraining("busy", (str(error),))
    type, name = STATE_TYPES[result.outcome], result.outcome.title().replace(" ", "")
    return final(State(type=type, name=name, message="; ".join(result.messages), data=result))


def _retrain(config: RetrainSettings, store: ArtifactStore, verbose: bool) -> Retraining:
    start = time.perf_counter()
    record: dict[str, Any] = {}
    try:
        failures = corpus.supervise(config, store, verbose).failures
        lessons = read_lessons(config.out / corpus.FILES["lessons"], store)
        places = read_places(config.out / corpus.FILES["views"])
        learnt = learn(lessons, config, store, verbose, places)
        version, used = learnt.version, Versions(config.models).current()
        outcome, messages = "nothing new", [learnt.message]
        if version is not None:
            outcome = "promoted" if version.promoted else "refused"
            record |= {"version": version.number, "scores": version.facts["scores"]["iou"]}
        if learnt.regressed:
            outcome = "regressed"
            end = f"`slgaussian versions {config.models} --use none` ends it"
            messages.append(f"{learnt.regressed}; {end}")
        if failures:
            first = failures[0]
            messages.append(f"left out: {len(failures)}, as {first.scene}: {first.reason}")
        number = 0 if used is None else used.number
        record |= {"in use": number, "outcome": outcome, "messages": messages}
    except Exception as error:
        expected = isinstance(error, SLGaussianError)
        reason = str(error) if expected else f"unexpected {type(error).__name__}: {error}"
        record = {"outcome": "failed", "messages": [reason]}
        raise
    finally:
        if "outcome" in record:  # not after a signal
            record["seconds"] = round(time.perf_counter() - start, 1)
            text = json.dumps(record, indent=1, ensure_ascii=False)
            write_atomic(config.out / RECORD, text.encode())
            paragraphs = f"# Retraining: {record['outcome']}", *record["messages"]
            publish(ARTIFACT, "\n\n".join([*paragraphs, f"```json\n{text}\n```\n"]))
    return Retraining(record["outcome"], tuple(record["messages"]))


def learn(
    table: pa.Table,
    settings: RetrainSettings,
    store: ArtifactStore,
    verbose: bool = False,
    places: Mapping[str, str] | None = None,
) -> Learnt:
    """Train on lessons from the weights in use, and promote the result if it is better.

    The candidate, the version in use, ``hard`` and ``filled`` are evaluated on the same held-out
    lessons. The candidate is promoted if it is significantly better than all others
    (:func:`slgaussian.benchmark.significance.gate`), and stored in any case. If lessons and
    settings are unchanged, nothing is trained.

    Raises:
        InputError: As in :func:`flows.training.parted` and :func:`flows.training.train_on`; if the
            weights in use had another fraction of held-out clips; or if a folder cannot be written.
    """
    versions = Versions(settings.models)
    history, incumbent = versions.all(), versions.current()
    lessons = parted(table, settings.held_out, places)
    requested = settings.model_dump(mode="json", include=set(TRAINING_SETTINGS))
    requested["lessons"] = {name: table_digest(side) for name, side in vars(lessons).items()}
    used = version_name(0 if incumbent is None else incumbent.number)
    if history and requested == history[-1].facts.get("asked"):
        return Learnt(f"nothing new since version {history[-1].number}; {used} is in use", None)
    start, rivals = None, NO_NETWORK
    if incumbent is not None:
        _check_share(settings, incumbent)
        start, rivals = versions.weights(incumbent), {"before": used, **NO_NETWORK}
    trained = train_on(lessons, settings, settings.codes, settings.seed, start, store, verbose)
    trained.write(settings.out)
    judgements = trained.judgements
    decision = gate(judgements, rivals)
    means = {name: float(np.mean(scores)) for name, scores in clip_scores(judgements).items()}
    scores = {"iou": means, "over hard": vars(gain(judgements, "hard"))}
    saw = sorted(map(mark_clip, lessons.learnt["clip"].unique().to_pylist()))
    facts = {"asked": requested, "counts": lessons.counts(), "scores": scores, "saw": saw}
    added = versions.add(trained.weights, facts, decision.better, decision.why, incumbent)
    if added.promoted:
        return Learnt(f"version {added.number} promoted: {added.why}", added)
    regressed = regression(judgements, NO_NETWORK, rivals.get("before", ""))
    message = f"version {added.number} stored, not promoted: {added.why}"
    return Learnt(message, added, regressed)


def _check_share(settings: RetrainSettings, incumbent: Version) -> None:
    """Raise InputError if the incumbent would be evaluated on its own training clips."""
    before = incumbent.facts.get("asked", {}).get("held_out")
    if before is not None and before != settings.held_out:
        raise InputError(
            f"held_out: found {settings.held_out:g}, but version {incumbent.number} in "
            f"{settings.models} was trained with {before:g}, perhaps on clips that are held out "
            f"now; keep {before:g}, or begin in another folder of versions"
        )
