"""Runs that are killed: nothing is lost, nothing is redone, nothing is left running."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

HERE = Path(__file__).parent


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


def start(store: Path, log: Path, sleep: float, runner: str = "threads") -> subprocess.Popen:
    hidden = ("PREFECT_API_URL", "PREFECT_HOME")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    env["PYTHONPATH"] = os.pathsep.join([str(HERE), str(HERE.parent.parent)])
    command = [sys.executable, str(HERE / "tiny_run.py"), str(store), str(log), str(sleep), runner]
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def servers_of(store: Path) -> list[int]:
    """Processes that have the store's Prefect home in their environment, from the kernel."""
    wanted = f"PREFECT_HOME={store}/.prefect".encode()
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and wanted in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def wait_until(condition, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="counts processes in /proc")
@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_run_resumes_and_leaves_no_server(tmp_path, server, kind):
    store, log = with_database(tmp_path / "store", server), tmp_path / "log"
    process = start(store, log, sleep=0.8)
    # The third stage has begun, so a first one has ended and is recorded.
    assert wait_until(lambda: log.exists() and "add" in log.read_text(), 120)
    assert len(servers_of(store)) >= 1
    process.send_signal(kind)
    # Standard output is a pipe here: a process left behind would hold it open.
    process.communicate(timeout=60)
    assert process.returncode == -kind
    assert wait_until(lambda: servers_of(store) == [], 30)
    if kind == signal.SIGTERM:
        return  # resuming is the same

    before = log.read_text().splitlines()
    finished = {line for line in before if line.endswith("make")} & {
        line.replace("halve", "make") for line in before if line.endswith("halve")
    }
    assert finished
    again = start(store, log, sleep=0.0)
    _, messages = again.communicate(timeout=120)
    assert again.returncode == 0, messages.decode()
    after = log.read_text().splitlines()[len(before) :]
    assert not finished & set(after)
    assert {line.split()[0] for line in before + after} == {"scene_0", "scene_1", "scene_2"}
    assert wait_until(lambda: servers_of(store) == [], 30)
    assert b"Traceback" not in messages
    assert not [p for p in store.rglob("*.tmp") if ".prefect" not in p.parts]
