"""Write a field or a ``.ply`` as one file: a page to send, or for other viewers."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.cli.objects import objects_meant
from flows.cli.query import open_field
from slgaussian.datasets.photographs import open_photograph
from slgaussian.errors import InputError, did_you_mean
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.formats.spz import save_spz
from slgaussian.io import file_digest, write_file
from slgaussian.storage.inputs import read_photographs
from slgaussian.viewer.page.scene_page import gaussians_page, scene_page

SUFFIXES = (".html", ".ply", ".spz")


def write(
    source: Path,
    out: Path,
    text: str | None,
    texts: Sequence[str],
    title: str | None,
    settings: Mapping[str, Any],
) -> None:
    """Write the field in folder ``source``, or a ``.ply``, to ``out``, whose suffix says how.

    Parameters
    ----------
    source, out : path
    text : str, optional
        An id, a name or a text of an object, which is written alone.
    texts : sequence of str
        Texts that a page shall answer beside the words that it knows anyway.
    title : str, optional
        Of a page.
    settings : mapping
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
    field = None
    if source.suffix.lower() == ".ply" and not source.is_dir():
        if text is not None or texts:
            raise InputError(
                f"{source}: a .ply has no objects and answers no words; leave out --object and "
                "--text"
            )
        if suffix == ".ply":
            raise InputError(f"{source}: is a .ply already; name another format")
        gaussians, labels = load_ply(source)[0], None
    else:
        if suffix == ".html" or text is not None:
            _, field = open_field(source, settings, rules=False)
        else:
            field = SemanticField.load(source)
        field = field.dropped()
        if text is not None:
            field = field.only(id_ for id_, _ in objects_meant(field, text, {}))
            if not len(field.gaussians):
                raise InputError(
                    f"--object {text!r}: nothing is found; `slgaussian objects list` has all"
                )
        gaussians, labels = field.gaussians, field.labels()
    if suffix == ".ply":
        save_ply(gaussians, out, labels)
    elif suffix == ".spz":
        save_spz(gaussians, out)
    else:
        if field is None:
            page = gaussians_page(gaussians, title or source.stem)
        else:
            page = scene_page(field, _photographs(source, field), texts, title)
        data = page.encode()
        write_file(out, data)
        size = f"{len(data) / 1e6:.1f} MB"
        print(f"{size}, to open in any browser, without a network", file=sys.stderr)


def _photographs(folder: Path, field: SemanticField) -> dict[str, np.ndarray]:
    """Read the photographs of a field that are still where they were, by view."""
    taken = {}
    for name, (file, digest) in read_photographs(folder).items():
        try:
            if name in field.cameras and file_digest(file) == digest:
                taken[name], _ = open_photograph(file, upright=True)
        except (InputError, OSError):  # it was moved; what the field drew is shown
            continue
    return taken
