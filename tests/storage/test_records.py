"""Records of finished work, and their checks without reading the artifacts."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slgaussian.storage.records import Records
from slgaussian.storage.store import DamagedError

KEY = f"train/v1/{'a' * 64}"


@pytest.fixture
def ref(local):
    weights = local.put("weights", {"safetensors": np.arange(100, dtype=np.uint8)})
    Records(local).keep(KEY, weights)
    return weights


def alter(local, ref, back_in_time: bool) -> None:
    """Change a byte, with or without the time of the file."""
    file = Path(local.path) / ref.uri
    before, data = file.stat(), bytearray(file.read_bytes())
    data[150] ^= 1
    file.write_bytes(data)
    changed = before.st_mtime_ns + (0 if back_in_time else 5_000_000_000)
    os.utime(file, ns=(changed, changed))


def read_stamps(local) -> list[str]:
    (file,) = Path(local.path).glob("keys/train/v1/*/*.json")
    return json.loads(file.read_text())["stamp"]


@pytest.mark.parametrize("back_in_time", [False, True])
def test_find_compares_times_of_a_damaged_artifact_and_get_its_digest(local, ref, back_in_time):
    assert Records(local).find(KEY) == ref
    alter(local, ref, back_in_time)
    assert Records(local).find(KEY) == (ref if back_in_time else None)
    with pytest.raises(DamagedError):
        local.get(ref)


def test_find_records_the_new_time_of_an_intact_artifact(local, ref):
    file = Path(local.path) / ref.uri
    os.utime(file, ns=(1, 1))
    before = read_stamps(local)
    assert Records(local).find(KEY) == ref
    assert read_stamps(local) == [f"{file.stat().st_size} 1"] != before


def test_find_ignores_record_with_missing_damaged_or_foreign_parts(local, ref, tmp_path):
    """A part is looked at even where the artifact itself is known by its time."""
    part = local.put("weights", {"safetensors": np.arange(9, dtype=np.uint8)})
    with_part = replace(ref, meta={"parts": [part.uri]})
    Records(local).keep(KEY, with_part)
    assert Records(local).find(KEY) == with_part
    outside = tmp_path / "outside.npz"
    outside.write_bytes(b"")
    Records(local).keep(KEY, replace(ref, meta={"parts": ["../outside.npz"]}))
    assert Records(local).find(KEY) is None
    for damage in (b"", Path(local.path, part.uri).read_bytes()[:100]):
        Records(local).keep(KEY, with_part)
        Path(local.path, part.uri).write_bytes(damage)
        assert Records(local).find(KEY) is None
        local.put("weights", {"safetensors": np.arange(9, dtype=np.uint8)})
    Records(local).keep(KEY, with_part)
    local.remove([part.uri])
    assert Records(local).find(KEY) is None
