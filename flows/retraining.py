"""Learn what is new in a corpus, and change the weights in use if that made them better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from flows import corpus
from flows.training import Parted, Trained, parted, read_lessons, train_on
from flows.training_settings import RetrainSettings, Training
from slgaussian.benchmark.verdict import Verdict, clip_scores, gain, verdict
from slgaussian.errors import InputError
from slgaussian.semantic.versions import Version, Versions
from slgaussian.storage.store import ArtifactStore, table_digest

ASKED = (*Training.model_fields, "codes", "seed")
"""The settings of which another value asks for another training."""


@dataclass(frozen=True)
class Learnt:
    """What came of it, in a sentence, and the version that was added, if any."""

    said: str
    version: Version | None


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
    table: pa.Table, settings: RetrainSettings, store: ArtifactStore, verbose: bool = False
) -> Learnt:
    """Train from the weights in use on lessons, and keep what is better.

    Candidate and incumbent, or no network while there is none, are judged on the same held-out
    lessons; the candidate is put to use if its gain is beyond noise
    (:func:`slgaussian.benchmark.verdict.verdict`), and kept in any case. Without anything new, in
    the lessons or the settings, nothing is trained.

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
        used = "no version" if incumbent is None else f"version {incumbent.number}"
        return Learnt(f"nothing new since version {history[-1].number}; {used} is in use", None)
    start = None
    if incumbent is not None:
        _check_share(settings, incumbent)
        start = versions.weights(incumbent)
    trained = train_on(lessons, settings, settings.codes, settings.seed, start, store, verbose)
    trained.write(settings.out)
    found = _verdict(trained, incumbent)
    facts = {**about, "scores": _scores(trained)}
    added = versions.add(trained.weights, facts, found.better, found.why, incumbent)
    done = "put to use" if found.better else "kept, not used"
    return Learnt(f"version {added.number} {done}: {found.why}", added)


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


def _verdict(trained: Trained, incumbent: Version | None) -> Verdict:
    if incumbent is None:
        # The best that there is without weights, and never below ``hard``.
        return verdict(trained.judgements, "filled", "no network (filled)")
    return verdict(trained.judgements, "before", f"version {incumbent.number}")


def _scores(trained: Trained) -> dict[str, Any]:
    means = {
        lifting: float(np.mean(scores))
        for lifting, scores in clip_scores(trained.judgements).items()
    }
    return {"iou": means, "over hard": vars(gain(trained.judgements, "hard"))}
