"""Write a field, or anybody's ``.ply``, as one file: a page to send, or for other viewers."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.cli.questions import opened
from flows.cli.things import meant
from slgaussian.datasets.photographs import open_photograph
from slgaussian.errors import InputError, did_you_mean
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.formats.spz import save_spz
from slgaussian.io import write_file
from slgaussian.parts.identity import file_digest
from slgaussian.storage.inputs import read_photographs
from slgaussian.viewer.page.scene_page import gaussians_page, scene_page

SUFFIXES = (".html", ".ply", ".spz")


def export(
    source: Path,
    out: Path,
    what: str | None = None,
    texts: Sequence[str] = (),
    title: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write the field in folder ``source``, or a ``.ply``, to ``out``, whose suffix says how.

    Parameters
    ----------
    source, out : path
    what : str, optional
        An id, a name or a text: what it means is written alone.
    texts : sequence of str
        What a page shall answer beside the words that it knows anyway.
    title : str, optional
        Of a page.
    settings : mapping, optional
        By the name of the field's encoder, a table that says where its files are now.

    Raises
    ------
    InputError
        If the suffix is none of :data:`SUFFIXES`, or anything given cannot be used.
    """
    suffix = out.suffix.lower()
    if suffix not in SUFFIXES:
        found = repr(out.suffix) if suffix else "no suffix"
        raise InputError(
            f"{out}: found {found}, expected the name of the file to end in "
            f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}{did_you_mean(suffix, SUFFIXES)}"
        )
    if suffix != ".html" and (texts or title):
        raise InputError(f"{out}: --text and --title are for pages (.html); leave them out")
    if source.suffix.lower() == ".ply" and not source.is_dir():
        _of_strangers(source, out, what, texts, title)
        return
    if suffix == ".html" or what is not None:
        _, field = opened(source, settings or {})
    else:
        field = SemanticField.load(source)
    field = field.dropped()
    if what is not None:
        ids = [id_ for id_, _ in meant(field, what, {})]
        field = field.only(ids)
        if not len(field.gaussians):
            raise InputError(f"--object {what!r}: nothing is found; `slgaussian objects` lists all")
    if suffix == ".html":
        _write_page(out, scene_page(field, _photographs(source, field), texts, title))
    elif suffix == ".ply":
        save_ply(field.gaussians, out, field.labels())
    else:
        save_spz(field.gaussians, out)


def _of_strangers(
    source: Path, out: Path, what: str | None, texts: Sequence[str], title: str | None
) -> None:
    if what is not None or texts:
        raise InputError(
            f"{source}: a .ply has no objects and answers no words; leave out --object and --text"
        )
    gaussians, _ = load_ply(source)
    suffix = out.suffix.lower()
    if suffix == ".html":
        _write_page(out, gaussians_page(gaussians, title or source.stem))
    elif suffix == ".ply":
        raise InputError(f"{source}: is a .ply already; name another format")
    else:
        save_spz(gaussians, out)


def _write_page(out: Path, page: str) -> None:
    data = page.encode()
    write_file(out, data)
    print(f"{len(data) / 1e6:.1f} MB, to open in any browser, without a network", file=sys.stderr)


def _photographs(folder: Path, field: SemanticField) -> dict[str, np.ndarray]:
    """The photographs of a field that are still where they were, by view."""
    taken = {}
    for name, (file, digest) in read_photographs(folder).items():
        try:
            if name in field.cameras and file_digest(file) == digest:
                taken[name], _ = open_photograph(file, upright=True)
        except (InputError, OSError):  # it was moved; what the field drew is shown
            continue
    return taken
