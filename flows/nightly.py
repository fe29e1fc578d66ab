"""A night: take in what is new, learn it, judge it; a record and a Prefect artifact are left.

Each night has a number and a file of that number, ``nights/000012.json``, in the output folder. It
says that the night is on, and in the end what came of it. One that still says so when the next
begins was ended from outside: a night holds a lock, which the kernel takes back. Nothing goes by
the time of day, so no clock that is put forward or back loses a night or counts one twice.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
from prefect import flow
from prefect.artifacts import create_markdown_artifact

from flows import corpus
from flows.dataset import dataset
from flows.night_settings import NightSet, NightSettings
from flows.pipeline import check_folder
from flows.retraining import Learnt, alone, failed_in, few, forgotten_by, learn
from flows.runners.journal import log
from flows.training import read_lessons
from slgaussian.datasets.arrivals import Changes, changes, clips_of, drift
from slgaussian.errors import InputError, SLGaussianError, SpecError
from slgaussian.formats import strict_json
from slgaussian.io import write_atomic
from slgaussian.semantic.versions import Versions, called
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore, decode_table, encode_table
from slgaussian.storage.tables import read_table

ARTIFACT = "slgaussian-night"
"""Key of the Prefect artifact of a night; a server keeps those of all nights."""

NAMES = 20
"""Names of each kind that a record has at most; there may be as many as there are clips."""

BY = "slgaussian nightly"


@dataclass(frozen=True)
class Night:
    """What came of a night.

    Attributes
    ----------
    outcome : str
        One of :data:`flows.night_settings.STATUS`.
    said : tuple of str
        Sentences for people.
    record : Path
        The JSON file of the night.
    """

    outcome: str
    said: tuple[str, ...]
    record: Path


def night(settings: NightSettings, store: ArtifactStore, verbose: bool = False) -> Night:
    """Have a night; needs Prefect to be ready (:func:`flows.runners.environment.orchestration`).

    Raises
    ------
    BusyError
        If a night or a retraining is on in the same folders; then nothing is done.
    InputError
        As :func:`flows.corpus.supervise` and :func:`flows.retraining.learn`; record and artifact
        say so first.
    """
    check_folder(settings.out)
    with alone(settings, "nightly"):
        records = _Records(settings.out)
        _bury(records)
        record = records.begin()
        start = time.perf_counter()
        try:
            clips = _work(settings, store, verbose, records, record)
        except Exception as error:
            known = isinstance(error, SLGaussianError)
            said = str(error) if known else f"unexpected {type(error).__name__}: {error}"
            record |= {"outcome": "failed", "said": [said]}
            raise
        finally:
            # What is stopped by a signal stays on record as being on: the next night says so.
            if record["outcome"] != "on":
                record["seconds"] = round(time.perf_counter() - start, 1)
                record["ended"] = _now()
                failed = record["outcome"] == "failed"
                records.end(record, None if failed else clips)
        return Night(record["outcome"], tuple(record["said"]), records.file(record["night"]))


def _work(
    settings: NightSettings,
    store: ArtifactStore,
    verbose: bool,
    records: _Records,
    record: dict[str, Any],
) -> pa.Table:
    """The steps of a night, what they found put down in its record; the clips that there are."""
    prepared = corpus.supervise(settings, store, verbose)
    before = records.last_clips()
    clips = clips_of(read_table(settings.out / corpus.FILES["views"]))
    failed = failed_in(prepared)
    found = changes(before, clips, failed)
    record["changes"] = {kind: _some(names) for kind, names in asdict(found).items()}
    left_out = {failure.scene: failure.reason for failure in prepared.failures}
    new = sorted(left_out.keys() - records.left_out())
    record["left out"] = sorted(left_out)
    record["newly left out"] = {name: left_out[name] for name in new[:NAMES]}
    record["drift"] = [asdict(one) for one in drift(before, _came(clips, found))]

    said = []
    if settings.training_set is not None:
        said.append(_build_set(settings, settings.training_set, store, verbose, record))
    lessons = read_lessons(settings.out / corpus.FILES["lessons"], store)
    done = [prepared.outcome]
    learnt = learn(lessons, settings, store, verbose, BY, clips, failed, done)
    versions = Versions(settings.models)
    used = versions.current()
    record |= {"in use": 0 if used is None else used.number, "forgotten": list(learnt.forgotten)}
    said.insert(0, learnt.said)
    if learnt.version is not None:
        record |= {
            "version": learnt.version.number,
            "scores": learnt.version.facts["scores"]["iou"],
        }
    if learnt.regressed:
        said.append(
            f"{learnt.regressed}; `slgaussian versions {settings.models} --use none` ends it"
        )
    if used is not None and (gone := forgotten_by(versions, used, clips, failed)):
        said.append(
            f"{called(used.number)}, in use, has learnt what was withdrawn or changed since: "
            f"{few(gone)}; `slgaussian versions {settings.models} --use none` ends it"
        )
    for name in new[:1]:
        said.append(f"left out for the first time: {len(new)}, as {name}: {left_out[name]}")
    drifted = [one["measure"] for one in record["drift"] if one["drifted"]]
    if drifted:
        said.append(f"what came is different from what there was in {', '.join(drifted)}")
    record |= {"outcome": _outcome(learnt, bool(new)), "said": said}
    return clips


def _build_set(
    settings: NightSettings,
    asked: NightSet,
    store: ArtifactStore,
    verbose: bool,
    record: dict[str, Any],
) -> str:
    """Bring the training set up to date; what is said of it. Without it, the night goes on."""
    try:
        made = dataset(settings.set_settings(asked), store, verbose)
    except InputError as error:
        record["training set"] = {"failed": str(error)}
        return f"the training set was not built: {error}"
    counts = {name: getattr(made, name) for name in ("samples", "places", "shards", "new_shards")}
    record["training set"] = {**counts, "left out": len(made.failures), "out": str(asked.out)}
    said = f"training set: {made.samples} samples of {made.places} places"
    return f"{said}, {made.new_shards} of {made.shards} shards new" if made.new_shards else said


def _outcome(learnt: Learnt, left_out: bool) -> str:
    if learnt.regressed:
        return "regressed"
    if learnt.version is None:
        return "left out" if left_out else "nothing new"
    return "promoted" if learnt.version.promoted else "refused"


def _came(clips: pa.Table, found: Changes) -> pa.Table:
    names = {*found.arrived, *found.changed}
    return clips.filter(pa.array([clip in names for clip in clips["clip"].to_pylist()], pa.bool_()))


def _some(names: Sequence[str]) -> dict[str, Any]:
    return {"count": len(names), "first": list(names[:NAMES])}


@flow(name=ARTIFACT, persist_result=False)
def publish(number: int, markdown: str) -> None:
    """Create the artifact of a night, version after version of one key."""
    create_markdown_artifact(markdown, ARTIFACT, f"Night {number}")


def night_markdown(record: Mapping[str, Any]) -> str:
    """Return the Markdown of a night's artifact; of one that failed, only why."""
    lines = [f"# Night {record['night']}: {record['outcome']}", *record["said"]]
    if "scores" in record:
        rows = [f"| {name} | {iou:.4f} |" for name, iou in record["scores"].items()]
        lines.append("\n".join(["| lifting | IoU on held-out clips |", "|---|---:|", *rows]))
    if "changes" in record:
        rows = [
            f"| {kind} | {some['count']} | {_cell(', '.join(some['first']))} |"
            for kind, some in record["changes"].items()
        ]
        lines.append("\n".join(["| clips | number | first |", "|---|---:|---|", *rows]))
        lines += [
            f"Left out: {_cell(f'{n}: {why}')}" for n, why in record["newly left out"].items()
        ]
    for one in record.get("drift", ()):
        low, _, high = one["known"]
        verdict = "drifted" if one["drifted"] else "as before"
        lines.append(f"{one['measure']}: {low:.3g} to {high:.3g}, now {one['come']:.3g}, {verdict}")
    if "seconds" in record:
        lines.append(f"{record['seconds']} s, begun {record['begun']}")
    return "\n\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """Escape a text for a cell: names of clips and reasons are no markup."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>|#!" else c for c in " ".join(text.split()))


def _bury(records: _Records) -> None:
    """Say of the last night that it was ended from outside, if it was."""
    last = records.last()
    if last is None or last["outcome"] != "on":
        return
    last |= {
        "outcome": "failed",
        "said": [f"night {last['night']}, begun {last['begun']}, was ended from outside; the next "
                 "goes on with what it made"],
    }  # fmt: skip
    records.end(last, None)


class _Records:
    """The files of the nights: a record of each, and of the last one the clips that there were."""

    def __init__(self, out: Path) -> None:
        self.folder = out / "nights"

    def file(self, number: int) -> Path:
        return self.folder / f"{number:06d}.json"

    def numbers(self) -> list[int]:
        return sorted(int(f.stem) for f in self.folder.glob("*.json") if f.stem.isdecimal())

    def read(self, number: int) -> dict[str, Any]:
        file = self.file(number)
        try:
            record = strict_json.parse(file.read_bytes())
            return {**record, "night": number, "outcome": str(record["outcome"])}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SpecError(f"{file}: cannot be read ({error!r:.200}); delete it") from error

    def last(self) -> dict[str, Any] | None:
        numbers = self.numbers()
        return self.read(numbers[-1]) if numbers else None

    def begin(self) -> dict[str, Any]:
        """The record of a new night, which is on."""
        self.folder.mkdir(exist_ok=True)
        number = max(self.numbers(), default=0) + 1
        record = {"night": number, "begun": _now(), "outcome": "on", "said": []}
        self._write(record)
        return record

    def end(self, record: dict[str, Any], clips: pa.Table | None) -> None:
        """Write the record, with which the night is over, and create its artifact.

        ``clips`` are what the next night compares with; None if nothing is known of them.
        """
        number = record["night"]
        if clips is not None:
            write_atomic(self._clips_of(number), encode_table(clips, load_spec("clips")))
        self._write(record | {"clips": clips is not None})
        if clips is not None:
            for file in self.folder.glob("*.clips.parquet"):
                if file != self._clips_of(number):
                    file.unlink()
        try:
            publish(number, night_markdown(record))
        except Exception as error:  # a server that is gone costs the artifact, not the night
            log(logging.WARNING, "artifact_failed", f"night {number} has no artifact: {error}")

    def last_clips(self) -> pa.Table:
        """What there was when the last night ended that knew; an empty table at first."""
        spec = load_spec("clips")
        for number in reversed(self.numbers()):
            if self.read(number).get("clips"):
                file = self._clips_of(number)
                return decode_table(file.read_bytes(), spec, str(file), "delete this night")
        return spec.schema.empty_table()

    def left_out(self) -> set[str]:
        """The names of what was left out in the last night that knew."""
        for number in reversed(self.numbers()):
            record = self.read(number)
            if record.get("clips"):
                return set(record["left out"])
        return set()

    def _clips_of(self, number: int) -> Path:
        return self.folder / f"{number:06d}.clips.parquet"

    def _write(self, record: dict[str, Any]) -> None:
        write_atomic(self.file(record["night"]), json.dumps(record, indent=1).encode())


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
