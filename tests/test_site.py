"""The site of the documentation: it builds without a warning and fetches nothing from elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("material", reason="needs mkdocs-material: the extra `docs`")

ROOT = Path(__file__).parents[1]

LOADED = re.compile(
    r'<(?:script|img|iframe)\b[^>]* src="?(https?:[^" >]+)|<link\b[^>]*="(https?:[^"]+)'
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    # The theme's authors tell of their plans for MkDocs 2 at every build.
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(words, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert "WARNING" not in built.stderr, built.stderr
    return folder


def test_site_has_every_page(site):
    pages = [page.relative_to(ROOT / "docs") for page in (ROOT / "docs").rglob("*.md")]
    assert [page for page in pages if not (site / page.with_suffix(".html")).is_file()] == []
    for page in ("start", "contributing", "changelog", "two_photographs"):
        assert (site / f"{page}.html").is_file()
    assert "data:image/jpeg;base64," in (site / "two_photographs.html").read_text("utf-8")


def test_site_loads_nothing_from_elsewhere(site):
    pages = [page.read_text("utf-8") for page in site.rglob("*.html")]
    assert [address for page in pages for address in LOADED.findall(page)] == []
