"""The log of a run in its output folder: an event a line, as JSON.

It is for operators and their collectors, and volatile: nothing reads it back. What is logged under
``slgaussian`` goes there, and to Prefect where its setting ``PREFECT_LOGGING_EXTRA_LOGGERS`` names
that logger.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from slgaussian.errors import SLGaussianError
from slgaussian.storage.specs import load_spec

FILE = "log.jsonl"
BEFORE = "log.1.jsonl"
"""What the log of the run before is called."""

LABEL = load_spec("log").label

_all = logging.getLogger("slgaussian")
_all.addHandler(logging.NullHandler())
# Prefect has a handler at the root that prints whatever reaches it.
_all.propagate = False
_log = logging.getLogger("slgaussian.run")


def log(
    level: int, event: str, message: str, error: BaseException | None = None, **facts: Any
) -> None:
    """Log an event of a run.

    Parameters
    ----------
    level : int
        As :mod:`logging` has them.
    event : str
        One word for what happened.
    message : str
        The same as a sentence, with scene and stage, for those who see nothing else.
    error : exception, optional
        One that is a defect, whose traceback is kept.
    **facts
        What else is known, as plain values: scene, stage, seconds ...
    """
    _log.log(level, message, exc_info=error, extra={"facts": {"event": event, **facts}})


@contextmanager
def log_to_file(out: Path, facts: Mapping[str, Any], verbose: bool = False) -> Iterator[None]:
    """Keep what is logged within the block in ``out/log.jsonl``.

    The file begins with the first event, so of a run that could not begin there is none, and ends
    with how the run ended; one that ends otherwise is of a run that was killed, or is still on. The
    file before becomes ``log.1.jsonl``. If it cannot be written, that is said once, and the run
    goes on.

    Parameters
    ----------
    out : Path
        A folder that is there when the first event comes.
    facts : mapping
        What the first line says of the run, as plain values; never credentials.
    verbose : bool
        Keep also what is only for looking into a run, such as each stage that was found done.
    """
    file = _File(out, facts)
    before = _all.level
    _all.addHandler(file)
    _all.setLevel(logging.DEBUG if verbose else logging.INFO)
    start = time.perf_counter()

    def ended(level: int, how: str, message: str, **facts: Any) -> None:
        if file.stream is not None:
            seconds = round(time.perf_counter() - start, 3)
            log(level, "ended", message, how=how, seconds=seconds, **facts)

    try:
        yield
    except SLGaussianError as error:
        ended(logging.ERROR, "refused", str(error))
        raise
    except Exception as error:
        ended(logging.ERROR, "failed", f"unexpected {type(error).__name__}: {error}", error=error)
        raise
    except BaseException:
        ended(logging.WARNING, "stopped", "stopped")
        raise
    else:
        ended(logging.INFO, "finished", "finished")
    finally:
        _all.setLevel(before)
        _all.removeHandler(file)
        file.close()


class _File(logging.Handler):
    def __init__(self, out: Path, facts: Mapping[str, Any]) -> None:
        super().__init__()
        self.path, self.facts = out / FILE, facts
        self.run = uuid.uuid4().hex[:12]
        self.stream: TextIO | None = None
        self.lost = False

    def emit(self, record: logging.LogRecord) -> None:
        if self.lost:
            return
        try:
            if self.stream is None:
                self._begin(record.created)
            self._write(self._fields(record))
        except OSError as error:
            self.lost = True
            print(f"{self.path}: cannot be written ({error.strerror}); going on without a log",
                  file=sys.stderr)  # fmt: skip
            self.close()

    def close(self) -> None:
        if self.stream is not None:
            with suppress(OSError):
                self.stream.close()
            self.stream = None
        super().close()

    def _begin(self, when: float) -> None:
        with suppress(FileNotFoundError):
            os.replace(self.path, self.path.with_name(BEFORE))
        self.stream = self.path.open("w", encoding="utf-8", errors="backslashreplace")
        self._write(
            {**_stamp(when, "info"), "run": self.run, "event": "run", "spec": LABEL, **self.facts}
        )

    def _fields(self, record: logging.LogRecord) -> dict[str, Any]:
        known = dict(getattr(record, "facts", {"event": "logged", "logger": record.name}))
        fields = {
            **_stamp(record.created, record.levelname.lower()),
            "run": self.run,
            **known,
            "message": record.getMessage(),
        }
        if record.exc_info:
            fields["traceback"] = logging.Formatter().formatException(record.exc_info)
        return fields

    def _write(self, fields: Mapping[str, Any]) -> None:
        assert self.stream is not None  # begun with the first record
        self.stream.write(json.dumps(fields, ensure_ascii=False, default=str) + "\n")
        self.stream.flush()


def _stamp(when: float, level: str) -> dict[str, str]:
    told = datetime.fromtimestamp(when, UTC).isoformat(timespec="milliseconds")
    return {"time": told.replace("+00:00", "Z"), "level": level}
