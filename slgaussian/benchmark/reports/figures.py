"""Plots in reports: one style, and SVG or PNG whose bytes depend on the data alone."""

from __future__ import annotations

import io
import re
from collections.abc import Callable

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slgaussian.benchmark.reports.model import Picture, data_uri

REMOVED_METADATA = ("Date", "Creator", "Format", "Type")
"""Metadata keys of Matplotlib that are removed from a picture."""

MUTED_COLOUR, ACCENT_COLOUR = "#667085", "#0072B2"

STYLE = {
    "svg.hashsalt": "slgaussian",
    "svg.fonttype": "path",
    "font.size": 9.5,
    # Colours that colour-blind readers tell apart (Okabe and Ito 2008).
    "axes.prop_cycle": "cycler(color=['#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', "
    "'#56B4E9', '#1d2330'])",
    "axes.edgecolor": "#d5dae2",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#eef0f4",
}
"""Settings of Matplotlib."""


def svg_picture(draw: Callable[[Axes], None], size: tuple[float, float], caption: str) -> Picture:
    """Return a plot of ``size`` inches that a function draws as a picture of a report."""
    svg = re.sub(rb"<!DOCTYPE[^>]*>\s*", b"", plot(draw, size, "svg"), flags=re.DOTALL)
    return Picture(data_uri(svg, "svg+xml"), caption, caption)


def plot(draw: Callable[[Axes], None], size: tuple[float, float], form: str) -> bytes:
    """Return a plot of ``size`` inches that a function draws as a file, ``svg`` or ``png``."""
    out = io.BytesIO()
    metadata = dict.fromkeys(REMOVED_METADATA if form == "svg" else ["Software"])
    with matplotlib.rc_context(STYLE):
        figure = Figure(size, dpi=144, layout="constrained")
        draw(figure.subplots())
        figure.savefig(out, format=form, metadata=metadata)
    return out.getvalue()
