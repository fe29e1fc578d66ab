from pathlib import Path

import numpy as np
import pytest

from slgaussian.errors import InputError
from slgaussian.storage.local_copies import LocalCache, cached_arrays

ROOT = Path(__file__).parents[2]
KB = bytes(1000)


def measure_folder(folder) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def test_cache_keeps_its_bound_and_recently_used_files(tmp_path):
    cache = LocalCache(tmp_path, 32 * 1000)
    cache.put("often", KB)
    for number in range(200):
        cache.put(f"a/{number}", KB)
        assert cache.get("often") == KB
        assert measure_folder(tmp_path) <= cache.bound
    assert cache.get("a/199") == KB
    assert cache.get("a/0") is None
    assert measure_folder(tmp_path) > cache.bound / 2


def test_cache_takes_size_and_folder_from_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv("SLGAUSSIAN_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("SLGAUSSIAN_CACHE_SIZE", raising=False)
    cache = LocalCache.from_environment()
    assert (cache.folder, cache.bound) == (tmp_path / "slgaussian" / "objects", 10**10)
    for text, size in (("500M", 5 * 10**8), ("1.5 GB", 15 * 10**8), ("2 tb", 2 * 10**12)):
        monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", text)
        assert LocalCache.from_environment().bound == size
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")
    assert LocalCache.from_environment() is None
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "much")
    with pytest.raises(InputError, match="SLGAUSSIAN_CACHE_SIZE: found 'much'"):
        LocalCache.from_environment()


def test_cached_arrays_recomputes_only_damaged_files(tmp_path, monkeypatch):
    monkeypatch.setenv("SLGAUSSIAN_CACHE", str(tmp_path))
    calls = []

    def make():
        calls.append(1)
        return {"squares": np.arange(6, dtype=np.uint8).reshape(2, 3)}

    for times, damage in ((1, None), (1, None), (2, b"PK no archive"), (2, None), (3, b"")):
        if damage is not None:
            (tmp_path / "outlines" / "a.npz").write_bytes(damage)
        arrays = cached_arrays("outlines/a.npz", make)
        assert len(calls) == times
        np.testing.assert_array_equal(arrays["squares"], [[0, 1, 2], [3, 4, 5]])
        assert arrays["squares"].dtype == np.uint8
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")
    cached_arrays("outlines/a.npz", make)
    assert len(calls) == 4
