"""The hard cases of `slgaussian doctor` pass, and fail for wrong code."""

import math
from dataclasses import replace

import pytest

from slgaussian.benchmark import hard_cases
from slgaussian.benchmark.hard_cases import nearest_code, rasterize, sigmoid, unproject


def test_hard_cases_stay_below_their_bounds():
    cases = hard_cases.measure_hard_cases()
    assert [case.case for case in cases if not case.good] == []
    assert len({(case.part, case.case) for case in cases}) == len(cases) == 18
    assert not replace(cases[0], error=cases[0].bound).good


def with_more_alpha(more):
    def broken(*scene, backend, settings):
        render = rasterize(*scene, backend=backend, settings=settings)
        return replace(render, alpha=render.alpha + (more if backend == "cpu" else 0))

    return broken


def of_the_next_pixel(cameras, *views):
    return unproject([camera.crop(1, 0, 32, 24) for camera in cameras], *views)


@pytest.mark.parametrize(
    ("name", "broken", "part", "number"),
    [
        ("sigmoid", lambda gaps: sigmoid(gaps) + 1e-9, "relevancy", 2),
        ("nearest_code", lambda *inputs: nearest_code(*inputs) ^ 1, "nearest code", 2),
        ("unproject", of_the_next_pixel, "depth to Gaussians", 2),
        ("rasterize", with_more_alpha(0.004), "rasterizer", 12),
        ("rasterize", with_more_alpha(math.nan), "rasterizer", 12),
    ],
)
def test_hard_cases_detect_wrong_kernels(monkeypatch, name, broken, part, number):
    monkeypatch.setattr(hard_cases, name, broken)
    wrong = [case for case in hard_cases.measure_hard_cases() if not case.good]
    assert [case.part.split(",")[0] for case in wrong] == [part] * number
