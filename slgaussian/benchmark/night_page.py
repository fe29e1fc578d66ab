"""What a night leaves to look at: one HTML page with what came of it and what it was given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from slgaussian.benchmark.rendering import template
from slgaussian.benchmark.training_report import ABOUT

KINDS = {
    "arrived": "new places",
    "changed": "changed since",
    "withdrawn": "withdrawn",
    "damaged": "cannot be read any more",
}
"""What a night says of clips."""


def render_night(record: Mapping[str, Any], before: Sequence[Mapping[str, Any]]) -> str:
    """One self-contained HTML page of a night: no network, no script.

    Parameters
    ----------
    record : mapping
        Its record, as :mod:`flows.nightly` keeps them. One of a night that failed says no more than
        that.
    before : sequence of mappings
        Those of the nights before it, the latest first.
    """
    return template("night.html.j2").render(
        night=record, before=before, kinds=KINDS, about=ABOUT, report="../report.html"
    )
