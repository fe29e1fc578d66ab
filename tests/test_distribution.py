"""Content of the wheel and the source archive; all other tests run from the source tree."""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("data_specs", "flows", "slgaussian", "tasks")
TRACKED = (ROOT / ".git").exists() and shutil.which("git") is not None


def source_files() -> set[str]:
    """Files that git tracks; without git, those of the packages and what builds a wheel of them."""
    if TRACKED:
        listing = ["git", "-C", str(ROOT), "ls-files", "-z"]
        listed = subprocess.run(listing, check=True, capture_output=True, text=True).stdout
        return {name for name in listed.split("\0") if name and (ROOT / name).is_file()}
    inside = {path for package in PACKAGES for path in (ROOT / package).rglob("*")}
    files = {path for path in inside | set(ROOT.iterdir()) if path.is_file()}
    return {p.relative_to(ROOT).as_posix() for p in files if p.parent.name != "__pycache__"}


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """A copy of those files, so that nothing is built in, or found in, the source tree."""
    folder = tmp_path_factory.mktemp("source")
    for name in source_files():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    return folder


def build(kind: str, source: Path, out: Path) -> Path:
    """The wheel or sdist that the build backend makes of ``source``; no network is needed."""
    code = f"from setuptools import build_meta as b; import sys; print(b.build_{kind}(sys.argv[1]))"
    command = [sys.executable, "-c", code, str(out)]
    # Without our own source tree, which tests have on their path.
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=source, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out / done.stdout.splitlines()[-1]


def test_wheel_holds_exactly_the_files_of_the_packages(copy, tmp_path):
    with zipfile.ZipFile(build("wheel", copy, tmp_path)) as wheel:
        names = set(wheel.namelist())
    metadata = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    package_files = names - metadata
    wanted = {name for name in source_files() if name.split("/")[0] in PACKAGES}
    assert sorted(wanted - package_files) == [], "left out of the wheel: add it to package-data"
    assert sorted(package_files - wanted) == [], "in the wheel, and not of the packages"
    assert any(name.endswith("/entry_points.txt") for name in metadata)


@pytest.mark.skipif(not TRACKED, reason="only git knows which files are of the repository")
def test_source_archive_holds_the_repository(copy, tmp_path):
    with tarfile.open(build("sdist", copy, tmp_path)) as archive:
        names = [member.name for member in archive.getmembers() if member.isfile()]
    files = {name.split("/", 1)[1] for name in names}
    assert sorted(source_files() - files) == [], "left out of the archive: add it to MANIFEST.in"
    generated = {name for name in files - source_files() if ".egg-info/" not in name}
    assert generated <= {"PKG-INFO", "setup.cfg"}


def test_pyproject_names_all_packages():
    """So that a package of a new name is not left out of both the wheel and the test above."""
    packages = {name.split("/")[0] for name in source_files() if name.endswith("/__init__.py")}
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert {f"{name}*" for name in PACKAGES} == set(config["packages"]["find"]["include"])
    assert packages - {"tests", "benches"} == set(PACKAGES)
