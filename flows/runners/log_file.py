"""The log of a run in its output folder: an event a line, as JSON.

It is for operators and their collectors, and volatile: nothing reads it back. What is logged under
``slgaussian`` goes there, and to Prefect where its setting ``PREFECT_LOGGING_EXTRA_LOGGERS`` names
that logger.
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
def log_to_file(out: Path, verbose: bool = False, **facts: Any) -> Iterator[None]:
    """Keep what is logged within the block in ``out/log.jsonl``, in place of an earlier log.

    Its first line has the ``facts`` of the run, as plain values and never credentials, its last how
    the run ended; a log that ends otherwise is of a run that was killed, or is still on. If it
    cannot be written, that is said once, and the run goes on. Finished stages that were cached are
    logged if ``verbose``.
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
        except OSError:  # it is opened with the first record
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
