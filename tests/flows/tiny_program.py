"""The flow of tiny stages as a program with its own server, for the tests that disturb it."""

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
    """Begin it in a folder of decoys beside ``log``; ``variables`` are of its environment."""
    hidden = ("PREFECT_API_URL", "PREFECT_HOME", "SLGAUSSIAN_NO_EVENTS")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    env |= {"HOME": str(home), "TMPDIR": str(home), **variables}
    env["PYTHONPATH"] = os.pathsep.join([str(HERE), str(HERE.parent.parent)])
    command = [sys.executable, str(HERE / "tiny_run.py"), str(store), str(log), str(sleep), runner]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    cwd = decoys(log.parent / "work")
    return subprocess.Popen(command, cwd=cwd, env=env, **pipes, start_new_session=True)


def decoys(folder: Path) -> Path:
    """The folder, with files called as our packages are: whatever process imports one ends."""
    for name in ("flows/__init__.py", "tasks.py", "data_specs/__init__.py"):
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("raise SystemExit('a file of the working folder was imported')\n")
    return folder


def with_database(store: Path, server) -> Path:
    """Give the store the database of the test server: making a new one takes ten seconds."""
    home = store / ".prefect"
    home.mkdir(parents=True)
    with (
        closing(sqlite3.connect(server.home / "prefect.db")) as source,
        closing(sqlite3.connect(home / "prefect.db")) as copy,
    ):
        source.backup(copy)
    return store


def lines_of(messages: bytes) -> list[str]:
    """How each line begins that was said, but for those that tell how far a slow run has come."""
    lines = filter(None, messages.decode().splitlines())
    begun = [re.split(r"[\s;]", line, maxsplit=1)[0] for line in lines]
    return [word for word in begun if not re.fullmatch(r"\d+/\d+", word)]


def wait_until(condition, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False
