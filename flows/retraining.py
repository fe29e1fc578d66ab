"""Learn what is new in a corpus, and change the weights in use if that made them better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from flows import corpus
from flows.training import Parted, parted, read_lessons, train_on
from flows.training_settings import RetrainSettings, Training
from slgaussian.benchmark.verdict import clip_scores, gain, gate, regression
from slgaussian.errors import InputError
from slgaussian.semantic.versions import Version, Versions, called
from slgaussian.storage.store import ArtifactStore, table_digest

ASKED = (*Training.model_fields, "codes", "seed")
"""The settings of which another value asks for another training."""


NO_NETWORK = {"hard": "no network (hard)", "filled": "no network (filled)"}
"""Liftings that need no weights. What is worse than one of them is of no use to anybody."""


@dataclass(frozen=True, eq=False)
class Learnt:
    """What came of it.

    Attributes
    ----------
    said : str
        In a sentence.
    version : Version or None
        What was added; None if there was nothing new.
    regressed : str
        A sentence if the version in use, before this, is worse than no network on what was held
        out; else empty.
    judgements : table of spec ``judgements``, or None if there was nothing new
    """

    said: str
    version: Version | None
    regressed: str = ""
    judgements: pa.Table | None = None


def retrain(
    settings: RetrainSettings, store: ArtifactStore, verbose: bool = False
) -> tuple[Learnt, corpus.Prepared]:
    """Ingest and supervise what is new, then :func:`learn` it.

    Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    InputError
        As :func:`flows.corpus.supervise` and :func:`learn`.
    """
    prepared = corpus.supervise(settings, store, verbose)
    lessons = read_lessons(settings.out / corpus.FILES["lessons"], store)
    return learn(lessons, settings, store, verbose), prepared


def learn(
    table: pa.Table,
    settings: RetrainSettings,
    store: ArtifactStore,
    verbose: bool = False,
    by: str = "slgaussian retrain",
) -> Learnt:
    """Train from the weights in use on lessons, and keep what is better.

    The candidate, the version in use, ``hard`` and ``filled`` are judged on the same held-out
    lessons. The candidate is put to use if it is better than each of the others beyond noise
    (:func:`slgaussian.benchmark.verdict.gate`), and kept in any case. Without anything new, in the
    lessons or the settings, nothing is trained. ``by`` goes to the history of the versions.

    Raises
    ------
    InputError
        As :func:`flows.training.parted` and :func:`flows.training.train_on`; if other clips were
        held out for the weights in use; or if a folder cannot be written.
    """
    versions = Versions(settings.models)
    history, incumbent = versions.all(), versions.current()
    lessons = parted(table, settings.held_out)
    about = _about(settings, lessons)
    if history and about["asked"] == history[-1].facts.get("asked"):
        used = called(0 if incumbent is None else incumbent.number)
        return Learnt(f"nothing new since version {history[-1].number}; {used} is in use", None)
    start, rivals = None, dict(NO_NETWORK)
    if incumbent is not None:
        _check_share(settings, incumbent)
        start = versions.weights(incumbent)
        rivals = {"before": called(incumbent.number), **rivals}
    trained = train_on(lessons, settings, settings.codes, settings.seed, start, store, verbose)
    trained.write(settings.out)
    judgements = trained.judgements
    found = gate(judgements, rivals)
    facts = {**about, "scores": _scores(judgements)}
    added = versions.add(trained.weights, facts, found.better, found.why, incumbent, by)
    done = "put to use" if added.promoted else "kept, not used"
    regressed = regression(judgements, NO_NETWORK, rivals.get("before", ""))
    said = f"version {added.number} {done}: {added.why}"
    return Learnt(said, added, "" if added.promoted else regressed, judgements)


def _about(settings: RetrainSettings, lessons: Parted) -> dict[str, Any]:
    given = settings.model_dump(mode="json", include=set(ASKED))
    digests = {name: table_digest(table) for name, table in vars(lessons).items()}
    return {"asked": {**given, "lessons": digests}, "counts": lessons.counts()}


def _check_share(settings: RetrainSettings, incumbent: Version) -> None:
    """The incumbent must not be judged on what it was trained on, nor favoured by it."""
    before = incumbent.facts.get("asked", {}).get("held_out")
    if before is not None and before != settings.held_out:
        raise InputError(
            f"held_out: found {settings.held_out:g}, but version {incumbent.number} in "
            f"{settings.models} was trained with {before:g} and may have learnt what it would be "
            f"judged by; keep {before:g}, or begin in another folder of versions"
        )


def _scores(judgements: pa.Table) -> dict[str, Any]:
    means = {lifting: float(np.mean(scores)) for lifting, scores in clip_scores(judgements).items()}
    return {"iou": means, "over hard": vars(gain(judgements, "hard"))}
