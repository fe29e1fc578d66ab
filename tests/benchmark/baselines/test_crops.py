"""Tiles, what lies between them, and what Gaussians carry of it, against plain float64."""

from dataclasses import replace

import numpy as np
import torch
from hypothesis import given as draw
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from slgaussian.benchmark.baselines import dense as drawn
from slgaussian.benchmark.baselines.crops import Level, choose_scales, encode_pyramid, tile_starts
from slgaussian.rasterize import rasterize

NOISE = 3e-7
"""Float32 sums of four shares of numbers up to 1; 1.2e-7 was measured."""


@draw(st.integers(1, 60), st.integers(1, 60), st.integers(1, 300))
def test_tiles_cover_an_axis_to_both_ends_evenly(side, stride, length):
    starts = tile_starts(length, side, min(stride, side))
    assert starts[0] == 0 and starts[-1] == max(length - side, 0)
    steps = np.diff(starts)
    # Half a pixel is lost to rounding at either end of a step.
    assert (steps <= min(stride, side) + 1).all() and (steps > 0).all()
    assert steps.max(initial=0) - steps.min(initial=10**6) <= 1


def some_level(rng, width: int = 3) -> Level:
    values = rng.standard_normal((2, 4, 5, width)).astype(np.float32)
    centres = np.array([4.0, 10, 17, 25]), np.array([3.0, 9, 20, 30, 37])
    return Level(values, centres, (30, 41))


def test_between_tiles_values_are_bilinear():
    rng = np.random.default_rng(0)
    level = some_level(rng)
    pixels = rng.permutation(2 * 30 * 41)
    found = level.at(pixels, 1, 3)
    view, rest = np.divmod(pixels, 30 * 41)
    y, x = np.divmod(rest, 41)
    places = np.stack([(y + 0.5).clip(4, 25), (x + 0.5).clip(3, 37)], 1)
    for number in range(2):
        plain = RegularGridInterpolator(
            level.centres, level.values[number, ..., 1:3].astype(np.float64)
        )
        mine = view == number
        np.testing.assert_allclose(found[mine], plain(places[mine]), atol=5 * NOISE)


def test_tiles_are_what_the_encoder_says_of_squares(given):
    (level,) = encode_pyramid(given, [40], [0.75])
    rows, columns = tile_starts(104, 40, 30), tile_starts(144, 40, 30)
    assert level.values.shape[:3] == (2, len(rows), len(columns))
    for view in range(2):
        mask = np.zeros((1, 104, 144), bool)
        mask[0, rows[1] : rows[1] + 40, columns[2] : columns[2] + 40] = True
        image, around = given.sample.context[view].image, given.geometry.surroundings[view]
        alone = given.encoder.encode_regions(image, mask, around)[0]
        np.testing.assert_array_equal(level.values[view, 1, 2], alone)
    assert level.centres[0][1] == rows[1] + 20


def test_drawn_vectors_are_those_of_the_reference(given, monkeypatch):
    rng = np.random.default_rng(0)
    camera = given.sample.targets[0].camera.resized(24, 16)
    keep = torch.from_numpy(rng.choice(len(given.gaussians), 300, replace=False))
    few = given.gaussians[keep]
    few = replace(few, scales=few.scales * 8)
    values = rng.standard_normal((2 * 104 * 144, 70)).astype(np.float32)
    (image,) = drawn.draw_vectors(few, camera, [lambda pixels, a, b: values[pixels, a:b]], 70)
    carried = torch.from_numpy(values[few.source.numpy()]).double()
    plain = rasterize(few, carried, camera, backend="reference").values.numpy()
    # The fast preset leaves out what is below 1/4096 of a pixel's light: of 300 that overlap
    # heavily, 3e-3 of values up to 4 was measured.
    np.testing.assert_allclose(image, plain, atol=1e-2)
    assert np.abs(plain).max() > 1


def test_each_pixel_believes_the_scale_at_which_a_class_leads_most(given):
    rng = np.random.default_rng(1)
    width = given.bank.features.shape[2]
    centres = np.array([20.0, 60, 90]), np.array([20.0, 70, 120])
    levels = []
    for _ in range(3):
        values = rng.standard_normal((2, 3, 3, width)).astype(np.float32)
        values /= np.linalg.norm(values, axis=-1, keepdims=True)
        levels.append(Level(values, centres, (104, 144)))
    classes = ["red carpet", "yellow wall", "wooden floor"]
    chosen = choose_scales(given, levels, classes)
    texts = given.reader.vectors(classes).astype(np.float64)
    pixels = rng.choice(2 * 104 * 144, 200, replace=False)
    for pixel in pixels:
        view, rest = divmod(int(pixel), 104 * 144)
        place = np.divmod(rest, 144)
        leads = []
        for level in levels:
            scores = level.values[view].astype(np.float64) @ texts.T
            at = np.clip(np.array(place) + 0.5, [20, 20], [90, 120])
            ranked = np.sort(RegularGridInterpolator(centres, scores)(at)[0])
            leads.append(ranked[-1] - ranked[-2])
        best = np.sort(leads)
        if best[-1] - best[-2] > 10 * NOISE:
            assert chosen[pixel] == np.argmax(leads)
    assert set(np.unique(chosen)) == {0, 1, 2}
