"""Records of retrainings: numbered JSON files, and the Markdown of their Prefect artifacts.

``history/000012.json`` in the output folder has the outcome of a retraining, or "on" while it runs.
If a record is still "on" when the next retraining begins, its process was killed, as a retraining
holds a lock that the kernel releases. Records are numbered and not ordered by time, so changes of
the clock have no effect.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from flows.runners.session import publish_markdown
from slgaussian.errors import SpecError
from slgaussian.formats import strict_json
from slgaussian.io import write_atomic
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec

ARTIFACT = "slgaussian-retraining"
"""Key of the Prefect artifacts of retrainings."""

NAMES = 20
"""Largest number of names of each kind in a record."""


class History:
    """The records of all retrainings, and the clips of the last one."""

    def __init__(self, out: Path) -> None:
        self.folder = out / "history"

    def file(self, number: int) -> Path:
        """Return the path of a record."""
        return self.folder / f"{number:06d}.json"

    def numbers(self) -> list[int]:
        """Return the numbers of all records, ascending."""
        return sorted(int(f.stem) for f in self.folder.glob("*.json") if f.stem.isdecimal())

    def read(self, number: int) -> dict[str, Any]:
        """Read a record; SpecError if it cannot be read."""
        file = self.file(number)
        try:
            record = strict_json.parse(file.read_bytes())
            return {**record, "number": number, "outcome": str(record["outcome"])}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SpecError(f"{file}: cannot be read ({error!r:.200}); delete it") from error

    def begin(self) -> dict[str, Any]:
        """Begin a record; if the last retraining was killed, first write its outcome."""
        self.folder.mkdir(exist_ok=True)
        numbers = self.numbers()
        if numbers and (last := self.read(numbers[-1]))["outcome"] == "on":
            reason = (
                f"retraining {last['number']}, begun {last['begun']}, was killed; the next one "
                "reuses its results"
            )
            self.end(last | {"outcome": "failed", "messages": [reason]}, None)
        record = {
            "number": max(numbers, default=0) + 1,
            "begun": datetime.now(UTC).isoformat(timespec="seconds"),
            "outcome": "on",
            "messages": [],
        }
        self._write(record)
        return record

    def end(self, record: dict[str, Any], clips: pa.Table | None) -> None:
        """Write the record of a finished retraining, and create its Prefect artifact.

        ``clips`` are stored for comparison by the next retraining; None if unknown.
        """
        number = record["number"]
        if clips is not None:
            write_atomic(self._clips_of(number), encode_table(clips, load_spec("clips")))
        self._write(record | {"clips": clips is not None})
        if clips is not None:
            for file in self.folder.glob("*.clips.parquet"):
                if file != self._clips_of(number):
                    file.unlink()
        publish_markdown(ARTIFACT, markdown_of(record), f"Retraining {number}")

    def previous(self) -> tuple[pa.Table, set[str]]:
        """Return the last stored clips, and the names of clips that were left out.

        An empty table and no names if there is none.
        """
        spec = load_spec("clips")
        for number in reversed(self.numbers()):
            record = self.read(number)
            if record.get("clips"):
                file = self._clips_of(number)
                table = decode_table(file.read_bytes(), spec, str(file), "delete this file")
                return table, set(record["left out"])
        return spec.schema.empty_table(), set()

    def _clips_of(self, number: int) -> Path:
        return self.folder / f"{number:06d}.clips.parquet"

    def _write(self, record: dict[str, Any]) -> None:
        write_atomic(self.file(record["number"]), json.dumps(record, indent=1).encode())


def markdown_of(record: Mapping[str, Any]) -> str:
    """Return the Markdown of a retraining's artifact: its messages, and the record as JSON."""
    rest = {k: v for k, v in record.items() if k not in ("messages", "left out")}
    block = f"```json\n{json.dumps(rest, indent=1, ensure_ascii=False)}\n```\n"
    title = f"# Retraining {record['number']}: {record['outcome']}"
    return "\n\n".join([title, *record["messages"], block])


def first_names(names: Sequence[str]) -> dict[str, Any]:
    """Return the number of names, and the first :data:`NAMES`."""
    return {"count": len(names), "first": list(names[:NAMES])}
