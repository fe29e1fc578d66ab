"""The server that the tool starts by itself."""

import re
import sqlite3
from contextlib import closing

import pytest
from process_family import LOOPBACK, PROC, listening

from flows.runners import server as local


@pytest.mark.skipif(not (PROC / "self/net/tcp").exists(), reason="asks the kernel in /proc")
def test_it_listens_on_loopback_only(server):
    """The process and its threads."""
    port = int(re.search(r":(\d+)/", server.url)[1])
    assert listening(server.process.pid) == [("tcp", f"{LOOPBACK[0]}:{port:04X}")]


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
