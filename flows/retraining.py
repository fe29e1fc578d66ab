"""Learn what is new in a corpus, and change the weights in use if that made them better."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flows import corpus
from flows.runners.worker_pool import Outcome
from flows.training import Parted, parted, read_lessons, train_on
from flows.training_settings import RetrainSettings, Training
from slgaussian.benchmark.verdict import clip_scores, gain, gate, regression
from slgaussian.datasets.arrivals import changes, clips_of
from slgaussian.errors import InputError
from slgaussian.semantic.versions import Version, Versions, called
from slgaussian.storage.locks import held
from slgaussian.storage.store import ArtifactStore, table_digest
from slgaussian.storage.tables import read_table

ASKED = (*Training.model_fields, "codes", "seed")
"""The settings of which another value asks for another training."""


LOCK = ".retrain.lock"

FEW = 3
"""Names that a sentence has at most."""

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
    forgotten : tuple of str
        Clips that the version in use had learnt and that were withdrawn or changed since: then
        training began anew, and not from it.
    judgements : table of spec ``judgements``, or None if there was nothing new
    """

    said: str
    version: Version | None
    regressed: str = ""
    forgotten: tuple[str, ...] = ()
    judgements: pa.Table | None = None


def retrain(
    settings: RetrainSettings, store: ArtifactStore, verbose: bool = False
) -> tuple[Learnt, corpus.Prepared]:
    """Ingest and supervise what is new, then :func:`learn` it.

    Needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    BusyError
        If another process does this to the same folders.
    InputError
        As :func:`flows.corpus.supervise` and :func:`learn`.
    """
    with alone(settings, "retrain"):
        prepared = corpus.supervise(settings, store, verbose)
        lessons = read_lessons(settings.out / corpus.FILES["lessons"], store)
        known = clips_of(read_table(settings.out / corpus.FILES["views"]))
        more = {"clips": known, "failed": failed_in(prepared), "before": [prepared.outcome]}
        return learn(lessons, settings, store, verbose, **more), prepared


@contextmanager
def alone(settings: RetrainSettings, what: str) -> Iterator[None]:
    """Nobody else retrains into these folders in the block; BusyError if somebody does."""
    with held(settings.out / LOCK, what), held(settings.models / LOCK, what):
        yield


def failed_in(prepared: corpus.Prepared) -> set[str]:
    """The names of the chunks and clips that could not be used."""
    return {failure.scene for failure in prepared.failures}


def learn(
    table: pa.Table,
    settings: RetrainSettings,
    store: ArtifactStore,
    verbose: bool = False,
    by: str = "slgaussian retrain",
    clips: pa.Table | None = None,
    failed: Collection[str] = (),
    before: Sequence[Outcome] = (),
) -> Learnt:
    """Train from the weights in use on lessons, and keep what is better.

    The candidate, the version in use, ``hard`` and ``filled`` are judged on the same held-out
    lessons. The candidate is put to use if it is better than each of the others beyond noise
    (:func:`slgaussian.benchmark.verdict.gate`), and kept in any case. Without anything new, in the
    lessons or the settings, nothing is trained. ``by`` goes to the history of the versions;
    ``before`` is what the same command made before, for its table of artifacts.

    ``clips`` are those of the corpus, spec ``clips``, and ``failed`` the names of the clips and
    chunks that could not be read. If the version in use has learnt what is no more among them,
    training begins anew, so that nothing of it is in what is built from now on.

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
    forgotten: tuple[str, ...] = ()
    if incumbent is not None:
        _check_share(settings, incumbent)
        start = versions.weights(incumbent)
        rivals = {"before": called(incumbent.number), **rivals}
        if clips is not None:
            forgotten = forgotten_by(versions, incumbent, clips, failed)
    given = settings.codes, settings.seed, None if forgotten else start, store, verbose
    trained = train_on(lessons, settings, *given, rival=start, readers=settings.readers)
    trained.write(settings.out, store, before)
    judgements = trained.judgements
    found = gate(judgements, rivals)
    facts = {**about, "scores": _scores(judgements), "forgotten": list(forgotten)}
    added = versions.add(
        trained.weights,
        facts,
        found.better,
        found.why,
        None if forgotten else incumbent,
        by,
        rival=incumbent,
        clips=None if clips is None else _learnt(clips, lessons),
    )
    done = "put to use" if added.promoted else "kept, not used"
    anew = ""
    if incumbent is not None and forgotten:
        anew = (
            f"; trained anew, as {called(incumbent.number)} has learnt what was withdrawn or "
            f"changed since: {few(forgotten)}"
        )
    regressed = regression(judgements, NO_NETWORK, rivals.get("before", ""))
    return Learnt(
        f"version {added.number} {done}: {added.why}{anew}",
        added,
        "" if added.promoted else regressed,
        forgotten,
        judgements,
    )


def forgotten_by(
    versions: Versions, version: Version, clips: pa.Table, failed: Collection[str]
) -> tuple[str, ...]:
    """The clips that a version has learnt and that are no more, or are others now, sorted."""
    gone: set[str] = set()
    for learnt in versions.learnt(version):
        found = changes(learnt, clips, failed)
        gone.update(found.withdrawn, found.changed)
    return tuple(sorted(gone))


def few(names: Sequence[str]) -> str:
    """Some names in words, and how many more there are."""
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return f"{', '.join(names[:FEW])}{more}"


def _learnt(clips: pa.Table, lessons: Parted) -> pa.Table:
    learnt = pa.array(sorted(set(lessons.learnt["clip"].to_pylist())))
    return clips.filter(pc.is_in(clips["clip"], learnt))


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
