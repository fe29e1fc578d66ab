"""Provenance in a file's metadata: program, stage, settings and versions of software.

It has no time, place, user or property of the machine, so the same installation writes the same
bytes from the same input. It is not part of an artifact's digest, which is over the content, so a
new version of a package does not change digests.
"""

from __future__ import annotations

import json
import platform
import subprocess
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slgaussian import __version__

if TYPE_CHECKING:
    import pyarrow as pa

PACKAGES = (
    "torch", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "scikit-image", "pyarrow",
    "matplotlib", "prefect", "transformers",
)  # fmt: skip
"""Packages whose version may change results; packages that are not installed are omitted."""


@dataclass(frozen=True)
class Provenance:
    """The computation that writes files.

    Attributes:
        stage: Name of the stage, command or function.
        version: Version of the stage.
        settings: Relevant settings as plain data, files and weights by digest.
        of: Specs of the input artifacts by argument name.
        passed_through: set of str. Digests of the inputs. An output with one of these digests has
            its origin elsewhere.
    """

    stage: str
    version: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    of: Mapping[str, str] = field(default_factory=dict)
    passed_through: Set[str] = frozenset()


_made: ContextVar[Provenance | None] = ContextVar("made", default=None)


@contextmanager
def record_provenance(work: Provenance) -> Iterator[None]:
    """Record this provenance in all files that are written within the block."""
    token = _made.set(work)
    try:
        yield
    finally:
        _made.reset(token)


def current_provenance() -> Provenance | None:
    """Return the provenance of the innermost :func:`record_provenance`."""
    return _made.get()


def provenance_metadata(digest: str = "") -> dict[str, Any]:
    """Return the metadata ``made`` of a file with this content digest."""
    work = current_provenance()
    if work is not None and digest in work.passed_through:
        work = None
    record: dict[str, Any] = {"program": f"slgaussian {__version__}"}
    if work is not None:
        record["stage"] = work.stage
        if work.version is not None:
            record["stage_version"] = work.version
        record |= {"settings": dict(work.settings), "of": dict(work.of)}
    record["software"] = software()
    return {"made": record}


def with_provenance(schema: pa.Schema, digest: str = "") -> pa.Schema:
    """Add the provenance to an Arrow schema's metadata, as a Parquet file stores it."""
    entries = {
        name: entry
        if isinstance(entry, str)
        else json.dumps(entry, sort_keys=True, ensure_ascii=False)
        for name, entry in provenance_metadata(digest).items()
    }
    return schema.with_metadata({**(schema.metadata or {}), **entries})


@cache
def software() -> dict[str, str]:
    """Return the versions of Python and of :data:`PACKAGES`."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


UNKNOWN = "unknown"
"""Commit of a program that is neither a clone nor installed from a repository."""


@cache
def commit() -> str:
    """Return the git commit of this program, with ``", changed"`` if its files differ from it.

    Of an installation from a repository, pip keeps it. :data:`UNKNOWN` of any other.
    """
    package = Path(__file__).resolve().parents[1]

    def git(*words: str) -> str:
        with suppress(OSError):  # not installed
            command = ["git", "-C", str(package), *words]
            return subprocess.run(command, capture_output=True, text=True).stdout.strip()
        return ""

    # A virtual environment in a folder of another repository is not tracked by it.
    if git("ls-files", "__init__.py"):
        folders = (f"../{name}" for name in ("slgaussian", "tasks", "flows", "data_specs"))
        changed = git("status", "--porcelain", "--", *folders)
        return git("rev-parse", "HEAD") + (", changed" if changed else "")
    with suppress(PackageNotFoundError):
        installed = distribution("slgaussian")
        if Path(str(installed.locate_file(package.name))).resolve() == package:
            origin = json.loads(installed.read_text("direct_url.json") or "{}")
            return origin.get("vcs_info", {}).get("commit_id", UNKNOWN)
    return UNKNOWN
