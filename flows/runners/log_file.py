"""Log of a run in its output folder, one JSON event on each line.

It is for operators and log collectors; the program does not read it. It contains records of the
logger ``slgaussian``, which Prefect receives too if ``PREFECT_LOGGING_EXTRA_LOGGERS`` names it.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from slgaussian.errors import SLGaussianError
from slgaussian.storage.specs import load_spec

FILE = "log.jsonl"

_all = logging.getLogger("slgaussian")
_all.addHandler(logging.NullHandler())
# Prefect's handler of the root logger would print the records.
_all.propagate = False
_log = logging.getLogger("slgaussian.run")


def log(
    level: int, event: str, message: str, error: BaseException | None = None, **facts: Any
) -> None:
    """Log an event of a run.

    Parameters
    ----------
    level : int
        A level of :mod:`logging`.
    event : str
        Name of the event, one word.
    message : str
        Complete sentence with scene and stage.
    error : exception, optional
        An unexpected error, whose traceback is logged.
    **facts
        Further plain values: scene, stage, seconds ...
    """
    _log.log(level, message, exc_info=error, extra={"facts": {"event": event, **facts}})


@contextmanager
def log_to_file(out: Path, verbose: bool = False, **facts: Any) -> Iterator[None]:
    """Log to ``out/log.jsonl`` within the block, replacing an earlier log.

    The first line has the ``facts`` of the run, plain values without credentials; the last line has
    how the run ended, unless it was killed or is still running. If the file cannot be written, a
    message is printed once, and the run continues. Cached stages are logged if ``verbose``.
    """
    with suppress(OSError):
        (out / FILE).unlink(missing_ok=True)
    file = _File(out / FILE, "a", "utf-8", delay=True, errors="backslashreplace")
    before, start = _all.level, time.time()
    _all.addHandler(file)
    _all.setLevel(logging.DEBUG if verbose else logging.INFO)
    log(logging.INFO, "run", "begun", spec=load_spec("log").label, **facts)
    level, how, message, defect = logging.INFO, "finished", "finished", None
    try:
        yield
    except SLGaussianError as error:
        level, how, message = logging.ERROR, "refused", str(error)
        raise
    except Exception as error:
        message = f"unexpected {type(error).__name__}: {error}"
        level, how, defect = logging.ERROR, "failed", error
        raise
    except BaseException:
        level, how, message = logging.WARNING, "stopped", "stopped"
        raise
    finally:
        seconds = round(time.time() - start, 3)
        log(level, "ended", message, defect, how=how, seconds=seconds)
        _all.setLevel(before)
        _all.removeHandler(file)
        file.close()


class _File(logging.FileHandler):
    def emit(self, record: logging.LogRecord) -> None:
        try:
            super().emit(record)
        except OSError:  # the file is opened with the first record
            self.handleError(record)

    def handleError(self, record: logging.LogRecord) -> None:
        error, path = sys.exc_info()[1], self.baseFilename
        reason = getattr(error, "strerror", None) or error
        print(f"{path}: cannot be written ({reason}); going on without a log", file=sys.stderr)
        _all.removeHandler(self)

    def format(self, record: logging.LogRecord) -> str:
        when = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        facts = getattr(record, "facts", {"event": "logged", "logger": record.name})
        fields = {"time": when.replace("+00:00", "Z"), "level": record.levelname.lower(), **facts}
        fields["message"] = record.getMessage()
        if record.exc_info:
            fields["traceback"] = logging.Formatter().formatException(record.exc_info)
        return json.dumps(fields, ensure_ascii=False, default=str)
