"""Provenance of a file, as the file says it: program, stage, settings, versions of software.

Never when, where or by whom, and nothing of one machine: what the same installation makes of the
same input has the same bytes. It is no part of an artifact's digest, which is over the content: a
new version of a package makes no artifact another one.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from slgaussian import __version__

if TYPE_CHECKING:
    import pyarrow as pa

PACKAGES = (
    "torch", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "scikit-image", "pyarrow",
    "matplotlib", "prefect", "transformers", "pycolmap",
)  # fmt: skip
"""Packages whose version may change a number; those that are not installed are left out."""


@dataclass(frozen=True)
class Provenance:
    """The work that makes files.

    Attributes
    ----------
    stage : str
        The stage, command or function.
    version : int or None
        That of the stage.
    settings : mapping
        Plain data: those that play a part, files and weights by their content.
    of : mapping
        What it was made of, by the name that the work has for it: the spec of an artifact.
    passed_through : set of str
        The digests of these: what comes out as it went in was made by others.
    source, licence : str
        Where the data come from and under which licence they are, where that is known.
    """

    stage: str
    version: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    of: Mapping[str, str] = field(default_factory=dict)
    passed_through: Set[str] = frozenset()
    source: str = ""
    licence: str = ""


_made: ContextVar[Provenance | None] = ContextVar("made", default=None)


@contextmanager
def making(work: Provenance) -> Iterator[None]:
    """Have the files that are written within the block say that this made them."""
    token = _made.set(work)
    try:
        yield
    finally:
        _made.reset(token)


@contextmanager
def saying(source: str, licence: str) -> Iterator[None]:
    """Have the files that are written within the block also say where their data come from."""
    work = current()
    with nullcontext() if work is None else making(replace(work, source=source, licence=licence)):
        yield


def current() -> Provenance | None:
    """Return the work of the innermost :func:`making`."""
    return _made.get()


def statement(digest: str = "") -> dict[str, Any]:
    """Return what a file with content of this digest says: ``made``, ``source`` and ``licence``.

    The latter where they are known.
    """
    work = current()
    if work is not None and digest in work.passed_through:
        work = None
    record: dict[str, Any] = {"program": f"slgaussian {__version__}"}
    origin = {}
    if work is not None:
        record["stage"] = work.stage
        if work.version is not None:
            record["stage_version"] = work.version
        record |= {"settings": dict(work.settings), "of": dict(work.of)}
        origin = {"source": work.source, "licence": work.licence}
    record["software"] = software()
    return {"made": record, **{name: text for name, text in origin.items() if text}}


def speaking(schema: pa.Schema, digest: str = "") -> pa.Schema:
    """Return a schema of a data spec that says what makes the table, as a Parquet file has it."""
    entries = {
        name: entry
        if isinstance(entry, str)
        else json.dumps(entry, sort_keys=True, ensure_ascii=False)
        for name, entry in statement(digest).items()
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
