"""Plots are SVG text that may stand in a page: same numbers, same bytes."""

import re

import numpy as np

from slgaussian.benchmark.reports.plots import plot_curves, plot_reliability, plot_worth
from slgaussian.benchmark.scores import Reliability

METHODS = [f"method {k}" for k in range(12)]


def drawings() -> list[str]:
    curves = {
        name: {t / 20: (k + 1) / (t + 12) for t in range(1, 20)} for k, name in enumerate(METHODS)
    }
    counts = np.arange(20) % 3
    binned = {
        name: Reliability(counts, np.minimum(counts, k % 3), counts * 0.05 * np.arange(20))
        for k, name in enumerate(METHODS)
    }
    return [plot_curves(curves, "method 0"), plot_reliability(binned, "method 0")]


def test_a_plot_stands_in_a_page_as_it_is_with_the_same_bytes():
    drawn = drawings()
    assert drawn == drawings()
    for svg in drawn:
        assert svg.startswith("<svg") and svg.rstrip().endswith("</svg>")
        assert "http" not in svg and "<script" not in svg
        assert not re.search(r"20\d\d-\d\d-\d\d", svg)  # no date
        assert len(svg) < 150_000


def test_names_of_points_never_lie_on_each_other():
    crowd = [(f"method {k}", 0.5 + k / 1e4, 1 + k / 1e4) for k in range(3)]
    apart = ("far away", 0.1, 0.001)
    svg = plot_worth([*crowd, apart], "method 1", "seconds")
    named = [name for name, *_ in (*crowd, apart) if name in svg]
    assert "method 1" in named and "far away" in named
    assert len(named) < 4
