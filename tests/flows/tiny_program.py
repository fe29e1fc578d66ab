"""The flow of tiny stages as a program with its own server, for tests that disturb it."""

import os
import re
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

HERE = Path(__file__).parent


def start(
    home: Path, store: Path, log: Path, sleep: float, runner: str, **variables: str
) -> subprocess.Popen:
    """Start ``tiny_run.py`` in a folder of decoys beside ``log``, with environment variables."""
    hidden = ("PREFECT_API_URL", "PREFECT_HOME", "SLGAUSSIAN_NO_EVENTS")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    env |= {"HOME": str(home), "TMPDIR": str(home), **variables}
    env["PYTHONPATH"] = os.pathsep.join([str(HERE), str(HERE.parent.parent)])
    command = [sys.executable, str(HERE / "tiny_run.py"), str(store), str(log), str(sleep), runner]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    cwd = write_decoys(log.parent / "work")
    return subprocess.Popen(command, cwd=cwd, env=env, **pipes, start_new_session=True)


def write_decoys(folder: Path) -> Path:
    """Write modules with the names of our packages that end a process which imports them."""
    for name in ("flows/__init__.py", "tasks.py", "data_specs/__init__.py"):
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("raise SystemExit('a file of the working folder was imported')\n")
    return folder


def with_database(store: Path, server) -> Path:
    """Copy the database of the test server into the store: a new one takes ten seconds."""
    home = store / ".prefect"
    home.mkdir(parents=True)
    with (
        closing(sqlite3.connect(server.home / "prefect.db")) as source,
        closing(sqlite3.connect(home / "prefect.db")) as copy,
    ):
        source.backup(copy)
    return store


def first_words(messages: bytes) -> list[str]:
    """First word of each line, without the lines of progress of a slow run."""
    lines = filter(None, messages.decode().splitlines())
    words = [re.split(r"[\s;]", line, maxsplit=1)[0] for line in lines]
    return [word for word in words if not re.fullmatch(r"\d+/\d+", word)]


def wait_until(condition, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False
