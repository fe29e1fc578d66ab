"""What made a file, as the file says it: program, stage, settings, versions of software.

Never when, where or by whom, and nothing of one machine: what the same installation makes of the
same input has the same bytes. It is no part of an artifact's digest, which is over the content: a
new version of a package makes no artifact another one.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
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
class Made:
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
    given : set of str
        The digests of these: what comes out as it went in was made by others.
    source, licence : str
        Where the data come from and under which licence they are, where that is known.
    """

    stage: str
    version: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    of: Mapping[str, str] = field(default_factory=dict)
    given: Set[str] = frozenset()
    source: str = ""
    licence: str = ""


_made: ContextVar[Made | None] = ContextVar("made", default=None)


@contextmanager
def making(made: Made) -> Iterator[None]:
    """Have the files that are written within the block say that this made them."""
    token = _made.set(made)
    try:
        yield
    finally:
        _made.reset(token)


@contextmanager
def saying(source: str, licence: str) -> Iterator[None]:
    """Have the files that are written within the block also say where their data come from."""
    made = current()
    if made is None:
        yield
        return
    with making(replace(made, source=source, licence=licence)):
        yield


def current() -> Made | None:
    """The work that is being done, as :func:`making` was told."""
    return _made.get()


def statement(digest: str = "") -> dict[str, Any]:
    """What a file with content of this digest says: ``made``, ``source`` and ``licence``.

    The latter where they are known.
    """
    made = current()
    if made is not None and digest in made.given:
        made = None
    said: dict[str, Any] = {"program": f"slgaussian {__version__}"}
    if made is not None:
        said["stage"] = made.stage
        if made.version is not None:
            said["stage_version"] = made.version
        said |= {"settings": dict(made.settings), "of": dict(made.of)}
    said["software"] = software()
    stated: dict[str, Any] = {"made": said}
    if made is not None:
        known = {"source": made.source, "licence": made.licence}
        stated |= {name: text for name, text in known.items() if text}
    return stated


def speaking(schema: pa.Schema, digest: str = "") -> pa.Schema:
    """A schema of a data spec that says what makes the table, too: what a Parquet file gets."""
    said = {
        name: own if isinstance(own, str) else json.dumps(own, sort_keys=True, ensure_ascii=False)
        for name, own in statement(digest).items()
    }
    return schema.with_metadata({**(schema.metadata or {}), **said})


@cache
def software() -> dict[str, str]:
    """The versions of Python and of :data:`PACKAGES`."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
