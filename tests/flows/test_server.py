"""The Prefect server that a command starts."""

import os
import re
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from prefect.settings.models.server.services import ServerServicesDBVacuumSettings
from process_family import LOOPBACK, PROC, listening

from flows.runners import server as local


@pytest.mark.skipif(not (PROC / "self/net/tcp").exists(), reason="asks the kernel in /proc")
def test_it_listens_on_loopback_only(server):
    """The process and its threads."""
    port = int(re.search(r":(\d+)/", server.url)[1])
    assert listening(server.process.pid) == [("tcp", f"{LOOPBACK[0]}:{port:04X}")]


def test_it_imports_in_the_order_of_this_program(monkeypatch):
    """A package in site-packages named like a standard module must not replace it."""
    places = ["/standard", str(Path(local.__file__).parents[2]), "/others"]
    monkeypatch.setattr(sys, "path", ["", *places])
    assert local.import_path() == os.pathsep.join(places)
    monkeypatch.setattr(sys, "path", ["", "/standard"])
    assert local.import_path() == os.pathsep.join([places[1], "/standard"])


def tables(home) -> list:
    with closing(sqlite3.connect(home / local.DATABASE)) as database:
        return database.execute("select name from sqlite_master").fetchall()


def test_a_new_database_is_kept_for_others_to_begin_with(tmp_path, monkeypatch):
    monkeypatch.setenv("SLGAUSSIAN_CACHE", str(tmp_path / "cache"))
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    for home in (first, second, third):
        home.mkdir()
    assert not local._lay_database(first) and not any(first.iterdir())
    with closing(sqlite3.connect(first / local.DATABASE)) as database:
        database.execute("create table runs (name)")
        local._keep_database(first)  # while a server has it open
    assert local._lay_database(second) and tables(second) == [("runs",)]
    assert [file.name for file in second.iterdir()] == [local.DATABASE]
    (stored,) = (tmp_path / "cache" / "prefect").iterdir()
    stored.write_bytes(stored.read_bytes()[:-1] + b"x")
    assert not local._lay_database(third) and not any(third.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_no_error_that_work_may_catch_and_ends_the_program(sign):
    program = f"""
import os
from flows.runners.environment import interruptible
with interruptible():
    try:
        os.kill(os.getpid(), {sign:d})
        os.getpid()
    except Exception:
        print("caught")
    finally:
        print("cleaned", flush=True)
print("went on")
"""
    stopped = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (stopped.returncode, stopped.stdout) == (-sign, "cleaned\n")
    assert stopped.stderr == "\nstopped; the same command goes on from here\n"


def test_the_retention_of_runs_in_the_guide_is_one_that_prefect_applies(monkeypatch):
    guide = (Path(__file__).parents[2] / "docs/guides/operations.md").read_text("utf-8")
    (given,) = re.findall(r"prefect config set (PREFECT_SERVER_SERVICES_DB_VACUUM\S+ \S+)", guide)
    for setting in given.split():
        monkeypatch.setenv(*setting.split("="))
    vacuum = ServerServicesDBVacuumSettings()
    assert vacuum.enabled_vacuum_types == {"events", "flow_runs", "orphans"}
    assert vacuum.retention_period == timedelta(days=30)
