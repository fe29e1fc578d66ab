"""Fusion: blended colours, at most two copies of a surface, no guess in front of it."""

import numpy as np
import pytest
from textured_planes import camera, make_links, sample

from slgaussian.predict.depth_completion import AGREES, cross_check
from slgaussian.predict.fusion import blend, select_pixels
from slgaussian.predict.view_graph import ViewGraph

# Written out, not imported: a slip in the module must show here.
FEATHER = 16.0


def blend_plainly(images, inverse_depths, steps, links):
    """The definition, pixel by pixel in float64."""
    out = []
    for i, sources in enumerate(links):
        H, W = inverse_depths[i].shape
        mixed = np.zeros((H, W, 3))
        gap = [float(np.linalg.norm(s.relative.t)) for s in sources]
        verdicts = [
            cross_check(inverse_depths[i], inverse_depths[s.source], s.relative, steps[i])
            for s in sources
        ]
        for y in range(H):
            for x in range(W):
                u, v = x + 0.5, y + 0.5
                weight = min(1, min(u, W - u, v, H - v) / FEATHER)
                total = weight * images[i][y, x].astype(float)
                for link, verdict, far in zip(sources, verdicts, gap, strict=True):
                    if verdict[y, x] != AGREES:
                        continue
                    (a, b), _ = link.relative.project(np.array([u, v]), inverse_depths[i][y, x])
                    h, w = inverse_depths[link.source].shape
                    say = min(1, min(a, w - a, b, h - b) / FEATHER) * (min(gap) / far) ** 2
                    left, top = int(np.floor(a - 0.5)), int(np.floor(b - 0.5))
                    observed = np.zeros(3)
                    for row, column in np.ndindex(2, 2):
                        share = 1 - abs(a - 0.5 - left - column)
                        share *= 1 - abs(b - 0.5 - top - row)
                        r, c = np.clip(top + row, 0, h - 1), np.clip(left + column, 0, w - 1)
                        observed += share * images[link.source][r, c]
                    total = total + say * observed
                    weight += say
                mixed[y, x] = total / weight
        out.append(mixed)
    return out


@pytest.mark.parametrize("views", [2, 3])
def test_a_blend_is_that_of_the_definition(views):
    """On noise, where a wrong pixel shows; half the depths of one view do not agree."""
    cameras = [camera(size=(24, 40), focal=30), camera(x=0.3, size=(24, 40), focal=33),
               camera(x=-0.2, y=0.2, size=(24, 40), focal=30)][:views]  # fmt: skip
    rng = np.random.default_rng(1)
    images = [rng.random((24, 40, 3), np.float32) for _ in cameras]
    depths = [1 / view.depth.astype(np.float32) for view in sample(*cameras).context]
    depths[1][:, ::2] *= 1.5
    links = make_links(*cameras)
    mixed = blend(images, depths, [0.001] * views, links)
    for result, expected in zip(
        mixed, blend_plainly(images, depths, [0.001] * views, links), strict=True
    ):
        assert result.dtype == np.float32
        # Weights and fractions of a pixel in float32: measured 4e-7.
        assert np.abs(result - expected).max() < 2e-6


def select(cameras, inverse, valid):
    """:func:`select_pixels` of linked views."""
    graph = ViewGraph(cameras, make_links(*cameras))
    return select_pixels(graph, inverse, valid, [0.001] * len(cameras))


def select_from_depths(cameras, depths, guessed=None):
    """Select the drawn pixels if all depths are confirmed except those of the view ``guessed``."""
    inverse = [1 / depth.astype(np.float32) for depth in depths]
    valid = [np.full_like(w, np.inf) if i == guessed else w for i, w in enumerate(inverse)]
    return select(cameras, inverse, valid)


def test_a_surface_is_drawn_by_two_views_at_most_and_what_is_new_by_all():
    cameras = [camera(x=x) for x in (0, 0.2, 0.4, 0.6)]
    depths = [view.depth for view in sample(*cameras).context]
    keep = select_from_depths(cameras, depths)
    assert keep[0].all() and keep[1].all()
    # The first two saw all of it but what lies beyond their borders, on the right.
    W = keep[2].shape[1]
    assert keep[2][:, : W // 2].mean() < 0.05
    assert keep[2][:, -5:].mean() > 0.9 and keep[3][:, -5:].mean() > 0.9
    assert keep[3].mean() < 0.4


def test_nothing_is_drawn_where_a_view_before_sees_through():
    cameras = [camera(x=x) for x in (0, 0.2, 0.4)]
    depths = [view.depth.copy() for view in sample(*cameras).context]
    depths[2][40:60, 40:60] *= 0.5
    keep = select_from_depths(cameras, depths)
    assert not keep[2][41:59, 41:59].any()


def test_a_guess_is_not_drawn_where_a_view_after_sees_through_but_does_not_refute_one():
    cameras = [camera(x=x) for x in (0, 0.2, 0.4)]
    depths = [view.depth.copy() for view in sample(*cameras).context]
    depths[0][40:60, 60:80] *= 0.5
    keep = select_from_depths(cameras, depths, guessed=0)
    assert not keep[0][41:59, 61:79].any()
    # Known, it stays: the views before decide about what is matched.
    assert select_from_depths(cameras, depths)[0].all()
    # Depth that the first view only guesses takes nothing from the others.
    depths[0][:] *= 4
    assert select_from_depths(cameras, depths, guessed=0)[2].mean() > 0.9


def test_a_guess_is_not_drawn_in_front_of_what_a_view_before_draws():
    cameras = [camera(x=x) for x in (0, 0.2, 0.4)]
    depths = [view.depth.copy() for view in sample(*cameras).context]
    inverse = [1 / depth.astype(np.float32) for depth in depths]
    # No view has matched anything in the middle; the third guesses it nearer than the others do.
    valid = [w.copy() for w in inverse]
    for w in valid:
        w[30:90, 30:130] = np.inf
    inverse[2][45:75, 60:100] *= 1.3
    assert not select(cameras, inverse, valid)[2][46:74, 61:99].any()
    # Matched there, it is drawn: guesses do not refute it.
    valid[2] = inverse[2]
    assert select(cameras, inverse, valid)[2][46:74, 61:99].mean() > 0.9
