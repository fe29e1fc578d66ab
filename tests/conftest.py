"""Shared by all tests: where real photographs may be found."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with real photographs, from the environment; tests that need it skip without it."""
    root = os.environ.get("SLG_TEST_DATA")
    if not root or not Path(root).is_dir():
        pytest.skip("SLG_TEST_DATA does not point at a folder with real data")
    return Path(root)
