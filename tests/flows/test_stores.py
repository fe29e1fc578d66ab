"""Flows on a shared store, and commands for its upkeep."""

import base64
import json
import os
import pickle
import time
from pathlib import Path

import numpy as np
import pytest
from command import read_error, run
from tiny_run import run_tiny, tiny

from flows.read_config import make_settings
from slgaussian.errors import InputError
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactRef, ArtifactStore

HERE = Path(__file__).parent
ALL = ["a add", "a halve", "a make"]


@pytest.fixture
def store(bucket):
    return ArtifactStore(f"{bucket}/slg")


def ran(store: ArtifactStore, log: Path, value: int = 6, extra: int = 1) -> list[str]:
    """Run, and return what was computed."""
    log.write_text("")
    outcome = run_tiny(store, {"a": tiny(value, extra, log)})
    assert outcome.failures == []
    return sorted(log.read_text().splitlines())


class Trap:
    def __reduce__(self):
        return (Path.touch, (Path(os.environ["TRAP"]),))


@pytest.mark.usefixtures("server")
def test_no_record_can_have_code_run(tmp_path, monkeypatch):
    monkeypatch.setenv("TRAP", str(tmp_path / "sprung"))
    store = ArtifactStore(tmp_path / "store")
    ran(store, tmp_path / "log")
    # As Prefect writes its own, which name the reader of their content.
    inner = base64.encodebytes(pickle.dumps(Trap())).decode()
    meta = {"serializer": {"type": "pickle"}, "prefect_version": "3.8.8"}
    trap = json.dumps({"metadata": meta, "result": inner}).encode()
    for records in Records(store).all():
        for record in records:
            store.write(record.file.uri, trap)
    assert ran(store, tmp_path / "log") == ALL
    assert not (tmp_path / "sprung").exists()


def count_files(store: ArtifactStore) -> int:
    return sum(len(files) for files in store.walk())


@pytest.mark.usefixtures("server")
def test_the_commands_look_after_a_store(store, tmp_path, monkeypatch, capsys):
    ran(store, tmp_path / "log")
    full = count_files(store)
    store.put("labels", {**store.get(any_ref(store)), "margin": quarters()})
    assert run(monkeypatch, "store", "gc", "--store", store.root) == 0
    out = capsys.readouterr().out
    assert "would be removed: nothing" in out
    assert "stays: 3 artifacts that are referred to, 1 others younger than 1 days" in out
    time.sleep(1.1)  # S3 says seconds
    assert run(monkeypatch, "store", "gc", "--store", store.root, "--age", "0", "--yes") == 0
    assert "removed: 1 artifacts that nothing refers to; " in capsys.readouterr().out
    assert count_files(store) == full

    assert run(monkeypatch, "inspect", store.root) == 0
    assert ran(store, tmp_path / "log") == []


def any_ref(store: ArtifactStore) -> ArtifactRef:
    return next(record.ref for records in Records(store).all() for record in records)


def quarters() -> np.ndarray:
    return np.full((1, 4, 5), 0.25, np.float32)


def test_results_of_older_stages_are_told_from_those_of_today(tmp_path, monkeypatch, capsys):
    from tasks.scene import geometry

    store = ArtifactStore(tmp_path / "store")
    for value, version in ((1, geometry.version), (2, geometry.version + 1)):
        output = store.put("weights", {"safetensors": quarters().view("u1").ravel() + value})
        Records(store).keep(f"geometry/v{version}/{value:064x}", output)
    words = ("store", "gc", "--store", store.root, "--age", "0", "--yes")
    assert run(monkeypatch, *words) == 0
    report = capsys.readouterr().out
    assert "removed: 1 artifacts that nothing refers to, 1 records of other versions" in report
    assert Records(store).find(f"geometry/v{geometry.version}/{1:064x}") is not None


def test_a_store_that_is_not_there_is_not_made_by_looking(tmp_path, monkeypatch, capsys):
    assert run(monkeypatch, "store", "gc", "--store", tmp_path / "typo") == 2
    assert "typo: found no folder, expected a store" in read_error(capsys)
    assert not (tmp_path / "typo").exists()


@pytest.mark.parametrize("key", ["store", "sources"])
def test_settings_refuse_credentials_without_printing_them(key, monkeypatch, capsys):
    place = "s3://AKIA123:hidden@bucket/x"
    words = {"store": ("demo", "--store", place), "sources": ("ingest", place, "-o", "out")}[key]
    assert run(monkeypatch, *words) == 2
    message = read_error(capsys)
    assert f"{key} s3://***@bucket/x: found credentials in the URL" in message
    assert "hidden" not in message and "AKIA123" not in message
    with pytest.raises(InputError, match="found credentials"):
        make_settings({"store": place}, "test")
