"""Records of finished work, and their checks without reading the artifacts."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore, DamagedError

KEY = f"train/v1/{'a' * 64}"


@pytest.fixture
def store(tmp_path):
    return ArtifactStore(tmp_path / "store")


@pytest.fixture
def ref(store):
    weights = store.put("weights", {"safetensors": np.arange(100, dtype=np.uint8)})
    Records(store).keep(KEY, weights)
    return weights


def alter(store, ref, back_in_time: bool) -> None:
    """Change a byte, with or without the time of the file."""
    file = Path(store.path) / ref.uri
    before, data = file.stat(), bytearray(file.read_bytes())
    data[150] ^= 1
    file.write_bytes(data)
    changed = before.st_mtime_ns + (0 if back_in_time else 5_000_000_000)
    os.utime(file, ns=(changed, changed))


def noted(store) -> list[str]:
    (file,) = Path(store.path).glob("keys/train/v1/*/*.json")
    return json.loads(file.read_text())["stamp"]


def test_an_artifact_that_was_changed_is_read_and_found_damaged(store, ref):
    assert Records(store).find(KEY) == ref
    alter(store, ref, back_in_time=False)
    assert Records(store).find(KEY) is None


def test_one_of_the_same_size_and_time_is_checked_by_who_reads_it(store, ref):
    alter(store, ref, back_in_time=True)
    assert Records(store).find(KEY) == ref
    with pytest.raises(DamagedError):
        store.get(ref)


def test_one_that_moved_is_checked_once_and_noted(store, ref):
    file = Path(store.path) / ref.uri
    os.utime(file, ns=(1, 1))
    before = noted(store)
    assert Records(store).find(KEY) == ref
    assert noted(store) == [f"{file.stat().st_size} 1"] != before


def test_a_record_whose_parts_are_gone_damaged_or_elsewhere_is_none(store, ref, tmp_path):
    """A part is looked at even where the artifact itself is known by its time."""
    part = store.put("weights", {"safetensors": np.arange(9, dtype=np.uint8)})
    with_part = replace(ref, meta={"parts": [part.uri]})
    Records(store).keep(KEY, with_part)
    assert Records(store).find(KEY) == with_part
    outside = tmp_path / "outside.npz"
    outside.write_bytes(b"")
    Records(store).keep(KEY, replace(ref, meta={"parts": ["../outside.npz"]}))
    assert Records(store).find(KEY) is None
    for damage in (b"", Path(store.path, part.uri).read_bytes()[:100]):
        Records(store).keep(KEY, with_part)
        Path(store.path, part.uri).write_bytes(damage)
        assert Records(store).find(KEY) is None
        store.put("weights", {"safetensors": np.arange(9, dtype=np.uint8)})
    Records(store).keep(KEY, with_part)
    store.remove([part.uri])
    assert Records(store).find(KEY) is None
