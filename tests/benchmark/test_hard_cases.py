"""The hard cases that `slgaussian doctor` measures: good here, and not where the code is wrong."""

import math
from dataclasses import replace

import pytest

from slgaussian.benchmark import hard_cases


@pytest.fixture(scope="module")
def cases():
    return hard_cases.measure_hard_cases()


def test_every_case_is_within_its_bound(cases):
    assert [case.case for case in cases if not case.good] == []
    assert len({(case.part, case.case) for case in cases}) == len(cases) >= 16


def test_a_case_at_its_bound_or_without_a_number_is_not_good(cases):
    assert not replace(cases[0], error=cases[0].bound).good
    assert not replace(cases[0], error=math.nan).good


@pytest.mark.parametrize(
    ("name", "broken", "part"),
    [
        ("sigmoid", lambda gaps: original("sigmoid")(gaps) + 1e-9, "relevancy"),
        ("nearest_code", lambda *inputs: original("nearest_code")(*inputs) ^ 1, "nearest code"),
        (
            "unproject",
            lambda seen, *inputs: original("unproject")([seen[0].cropped(1, 0, 32, 24)], *inputs),
            "depth to Gaussians",
        ),
        (
            "rasterize",
            lambda *scene, backend, settings: replace(
                drawn := original("rasterize")(*scene, backend=backend, settings=settings),
                alpha=drawn.alpha + (0.004 if backend == "cpu" else 0),
            ),
            "rasteriser",
        ),
    ],
)
def test_what_is_computed_wrongly_is_named(monkeypatch, name, broken, part):
    monkeypatch.setattr(hard_cases, name, broken)
    wrong = [case for case in hard_cases.measure_hard_cases() if not case.good]
    assert wrong and {case.part.split(",")[0] for case in wrong} == {part}


_ORIGINAL = {
    name: getattr(hard_cases, name)
    for name in ("sigmoid", "nearest_code", "unproject", "rasterize")
}


def original(name):
    return _ORIGINAL[name]
