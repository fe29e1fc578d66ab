"""Shared by all tests: where real photographs may be found, and how many threads work."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from slgaussian import threads

# Several test processes share the cores; threads that spin while they wait would take them away.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with real photographs, from the environment; tests that need it skip without it."""
    root = os.environ.get("SLG_TEST_DATA")
    if not root or not Path(root).is_dir():
        pytest.skip("SLG_TEST_DATA does not point at a folder with real data")
    return Path(root)


@pytest.fixture
def one_thread() -> Iterator[None]:
    """For small networks: a thread more gains little there, and on a busy machine it costs much."""
    threads.share(threads.cores())
    yield
    threads.share()
