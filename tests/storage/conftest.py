"""Stores of every kind."""

import uuid

import pytest

from slgaussian.storage.store import ArtifactStore


@pytest.fixture(params=["local", "memory", "s3"])
def store(request, tmp_path, monkeypatch) -> ArtifactStore:
    """An empty store on disk, in memory and in a bucket, without copies of what it holds."""
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")
    if request.param == "s3":
        return ArtifactStore(request.getfixturevalue("bucket") + "/some/prefix")
    root = tmp_path / "store" if request.param == "local" else f"memory://{uuid.uuid4().hex}"
    return ArtifactStore(root)


@pytest.fixture
def local(tmp_path) -> ArtifactStore:
    """An empty store on disk."""
    return ArtifactStore(tmp_path / "store")
