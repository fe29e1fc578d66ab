"""A splat that exists: kept as it is, answered with words, and refused where it cannot be used."""

from dataclasses import replace

import numpy as np
import pytest

from benches.semantic.existing_splats import exact_splat, score
from slgaussian import datasets
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.errors import InputError
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.predict import load_predictor
from slgaussian.predict.splat_check import check_world
from slgaussian.predict.splat_views import choose_views, render_sample, surround

FIELDS = ("means", "scales", "quats", "opacities", "sh")
ENDS, BETWEEN, SIZE = ("view_00", "view_05"), ("view_02",), (144, 192)


@pytest.fixture(scope="module")
def room():
    return datasets.load("procedural", seed=0, objects=4, views=6, height=216, width=288)


@pytest.fixture(scope="module")
def file(room, tmp_path_factory):
    place = tmp_path_factory.mktemp("splat") / "room.ply"
    save_ply(exact_splat(room, list(room.cameras), 216, 288), place)
    return place


def method(place, **components):
    return Method("gaussians", settings={"gaussians": {"splat": place}}, **components)


def test_field_keeps_the_bytes_of_a_splat_and_answers_as_well_as_one_of_photographs(room, file):
    sample = room.sample(ENDS, BETWEEN, SIZE)
    field = build_field(sample, method(file))
    stored, given = field.gaussians.to_arrays(), load_ply(file)[0].to_arrays()
    assert all(stored[name].tobytes() == given[name].tobytes() for name in FIELDS)
    assert (stored["source"] == -1).all()
    assert field.settings["views"] == {"kind": "photographs", "names": list(ENDS)}
    assert field.settings["quality"]["detail"] > 0.6
    assert score(field, sample)[0] > score(build_field(sample), sample)[0] - 0.02


FLIP, QUARTER = np.diag([1.0, -1, -1, 1]), np.eye(4)[[0, 2, 1, 3]] * [[1], [1], [-1], [1]]


def mirror(gaussians, axis):
    arrays = gaussians.to_arrays()
    means, quats = arrays["means"].copy(), arrays["quats"].copy()
    means[:, axis] *= -1
    quats[:, [1 + other for other in range(3) if other != axis]] *= -1
    return gaussians.with_arrays(means=means, quats=quats)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda c2w: c2w @ FLIP, "y and z of each camera's own axes reversed"),
        (lambda c2w: FLIP @ c2w, "y and z of the cameras' world reversed"),
        (lambda c2w: QUARTER @ c2w, "turned from y up to z up"),
        (lambda c2w: c2w * ([[1, 1, 1, 100]] * 3 + [[1] * 4]), "times 0.01"),
        (lambda c2w: c2w * ([[1, 1, 1, 0.5]] * 3 + [[1] * 4]), "times 2 it would"),
        ("mirrored", "with x of the splat reversed, so that it is mirrored"),
        ("another", "expected 35% or more: give the cameras by which it was trained"),
    ],
)
def test_check_world_refuses_other_worlds_and_says_what_explains_them(room, file, change, sentence):
    gaussians = load_predictor("gaussians", splat=file).read("room")
    views = [room.read(name) for name in ENDS]
    assert check_world(gaussians, views).detail > 0.6
    if change == "mirrored":
        gaussians = mirror(gaussians, 0)
    elif change == "another":
        other = datasets.load("procedural", seed=5, objects=4, views=6, height=216, width=288)
        views = [other.read(name) for name in ENDS]
    else:
        views = [
            replace(view, camera=replace(view.camera, c2w=change(view.camera.c2w)))
            for view in views
        ]
    with pytest.raises(InputError, match="two worlds: .*" + sentence):
        check_world(gaussians, views)
    check_world(gaussians, views, trusted=True)


def test_predictor_refuses_what_is_no_splat(file, tmp_path):
    gaussians, _ = load_ply(file)
    invisible = gaussians.with_arrays(opacities=np.zeros(len(gaussians), np.float32))
    save_ply(gaussians[:0], tmp_path / "empty.ply")
    save_ply(invisible, tmp_path / "invisible.ply")
    (tmp_path / "field").mkdir()
    (tmp_path / "field" / "field.json").write_text("{}")
    for splat, sentence in [
        (None, "none given; give a .ply or .spz"),
        (tmp_path / "no.ply", "there is no "),
        (tmp_path / "empty.ply", "none of its 0 Gaussians is visible"),
        (tmp_path / "invisible.ply", "Gaussians is visible; give a splat with opacities above 0"),
        (tmp_path / "field", "is a field, which answers words already"),
        (tmp_path, "has no splat of scene 'room'; expected room with .ply"),
    ]:
        with pytest.raises(InputError, match=sentence):
            load_predictor("gaussians", splat=splat).read("room")
    save_ply(gaussians, tmp_path / "room.ply")
    assert len(load_predictor("gaussians", splat=tmp_path).read("room")) == len(gaussians)


def test_field_refuses_liftings_that_need_pixels(room, file):
    with pytest.raises(InputError, match="lifting 'filled': needs a Gaussian for each pixel"):
        build_field(room.sample(ENDS, size=SIZE), method(file, lifting="filled"))


def test_choose_views_takes_those_that_show_most_and_no_more_than_needed(room, file):
    gaussians = load_predictor("gaussians", splat=file).read("room")
    sample = room.sample(list(room.cameras), size=SIZE)
    chosen = choose_views(sample, gaussians)
    assert len(chosen.context) == 5
    blank = replace(sample.context[0], image=np.full_like(sample.context[0].image, 90))
    worse = choose_views(replace(sample, context=(blank, *sample.context[1:])), gaussians)
    assert worse.context == sample.context[1:]  # no edge is as blurred as can be


def test_render_sample_shows_the_splat_at_cameras_and_around_it(room, file):
    gaussians = load_predictor("gaussians", splat=file).read("room")
    sample = render_sample("room", gaussians, dict(room.cameras), "original", "at the cameras")
    difference = sample.context[0].image.astype(float) - room.read("view_00").image
    assert np.abs(difference).mean() < 12
    ring = render_sample("room", gaussians, surround(gaussians), "auto", "around")
    assert min(view.opaque.mean() for view in ring.context) > 0.2
    away = {name: replace(c, c2w=c.c2w @ FLIP) for name, c in room.cameras.items()}
    with pytest.raises(InputError, match="none of the 6 cameras shows any of its Gaussians"):
        render_sample("room", gaussians, away, "original", "")
