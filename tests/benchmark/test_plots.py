"""Plots are SVG text that may stand in a page: same numbers, same bytes."""

import re

from slgaussian.benchmark.reports.plots import plot_worth


def test_a_plot_stands_in_a_page_as_it_is_with_the_same_bytes():
    points = [(f"method {k}", (k + 1) / 12, 0.1 * (k + 1)) for k in range(12)]
    svg = plot_worth(points, "method 0", "seconds")
    assert svg == plot_worth(points, "method 0", "seconds")
    assert svg.startswith("<svg") and svg.rstrip().endswith("</svg>")
    assert "http" not in svg and "<script" not in svg
    assert not re.search(r"20\d\d-\d\d-\d\d", svg)  # no date


def test_names_of_points_never_lie_on_each_other():
    crowd = [(f"method {k}", 0.5 + k / 1e4, 1 + k / 1e4) for k in range(3)]
    apart = ("far away", 0.1, 0.001)
    svg = plot_worth([*crowd, apart], "method 1", "seconds")
    named = [name for name, *_ in (*crowd, apart) if name in svg]
    assert "method 1" in named and "far away" in named
    assert len(named) < 4
