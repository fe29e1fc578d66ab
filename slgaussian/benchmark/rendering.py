"""Pages of templates: HTML that needs no network, and Markdown."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import jinja2
import numpy as np

from slgaussian.benchmark.pictures import encode_jpeg


def template(name: str) -> jinja2.Template:
    """The template of that file name beside this module.

    In one whose name ends in ``.html.j2`` names are text and never markup; one of Markdown passes
    what stands in a table through the filter ``cell``.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slgaussian.benchmark", "."),
        autoescape=lambda own: own is not None and own.endswith(".html.j2"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["cell"] = cell
    return environment.get_template(name)


def cell(text: Any) -> str:
    """Text as it may stand in a cell of a Markdown table: one line, no bar, no markup."""
    flat = " ".join(str(text).split())
    for mark in "\\`*_<>|[]":
        flat = flat.replace(mark, f"\\{mark}")
    return flat


def flatten(tree: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """The leaves of nested mappings as text, keys joined by dots."""
    flat: list[tuple[str, str]] = []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat += flatten(value, f"{prefix}{key}.")
        else:
            flat.append((f"{prefix}{key}", str(value)))
    return flat


def data_uri(picture: np.ndarray, width: int) -> str:
    """A picture uint8 RGB as the address of itself: a JPEG at most ``width`` pixels wide."""
    return f"data:image/jpeg;base64,{base64.b64encode(encode_jpeg(picture, width)).decode()}"
