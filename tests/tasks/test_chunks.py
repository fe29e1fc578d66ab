"""The digest of a file is cached until the file changes."""

import hashlib
import os
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import fsspec
import pytest

from slgaussian.errors import InputError
from slgaussian.storage import file_digests
from slgaussian.storage.file_digests import read_digest
from slgaussian.storage.store import ArtifactStore


@pytest.fixture
def hash_count(monkeypatch):
    """Count how often a file is read."""
    counts = []
    digest = hashlib.file_digest
    monkeypatch.setattr(
        file_digests.hashlib, "file_digest", lambda *a: counts.append(1) or digest(*a)
    )
    return counts


def sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_a_file_is_read_once_until_it_changes(tmp_path, hash_count):
    store, file = ArtifactStore(tmp_path / "store"), tmp_path / "x.torch"
    file.write_bytes(b"one")
    old = time.time() - 100
    os.utime(file, (old, old))
    assert read_digest(store, str(file)) == read_digest(store, str(file)) == sha(b"one")
    assert len(hash_count) == 1
    file.write_bytes(b"two")
    os.utime(file, (old + 1, old + 1))
    assert read_digest(store, str(file)) == sha(b"two")
    file.write_bytes(b"three")
    os.utime(file, (old + 1, old + 1))  # the same time, another size
    assert read_digest(store, str(file)) == sha(b"three")
    time.sleep(0.02)  # more than a tick of the clock
    file.write_bytes(b"seven")
    os.utime(file, (old + 1, old + 1))  # the same time and size
    assert read_digest(store, str(file)) == sha(b"seven")
    assert len(hash_count) == 4


def test_a_damaged_memory_is_no_harm(tmp_path, hash_count):
    store, file = ArtifactStore(tmp_path / "store"), tmp_path / "x.torch"
    file.write_bytes(b"one")
    os.utime(file, (0, 0))
    read_digest(store, str(file))
    (note,) = (tmp_path / "store" / "digests").iterdir()
    for damage in (b"", b"[]", b'{"size": 3}', b"\xff"):
        note.write_bytes(damage)
        assert read_digest(store, str(file)) == sha(b"one")
    assert len(hash_count) == 5


def test_a_url_works_too(tmp_path, hash_count):
    fs = fsspec.filesystem("memory")
    fs.pipe_file("/digests/x.torch", b"one")
    store = ArtifactStore("memory://store-of-digests")
    assert read_digest(store, "memory://digests/x.torch") == sha(b"one")
    assert read_digest(store, "memory://digests/x.torch") == sha(b"one")
    assert len(hash_count) == 1
    with pytest.raises(InputError, match=r"memory://digests/y\.torch: cannot be read"):
        read_digest(store, "memory://digests/y.torch")


def test_a_file_that_changed_on_a_server_is_read_again(tmp_path, hash_count):
    pytest.importorskip("aiohttp")
    store, file = ArtifactStore(tmp_path / "store"), tmp_path / "x.torch"
    handler = partial(SimpleHTTPRequestHandler, directory=tmp_path)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/x.torch"
        for age, content in ((100, b"one"), (50, b"two")):
            file.write_bytes(content)
            os.utime(file, (time.time() - age,) * 2)
            assert read_digest(store, url) == read_digest(store, url) == sha(content)
        server.shutdown()
    assert len(hash_count) == 2
