"""Scenes far from the origin of the world, and in other units, against the same scene at home."""

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

import slgaussian as slg
from slgaussian.build import see_targets
from slgaussian.datasets import load, re10k
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.formats.spz import save_spz
from slgaussian.predict import load_predictor
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera, Sample, Scene, View, local_origin
from slgaussian.semantic.lesson import Lesson
from slgaussian.viewer.page.scene_page import scene_page
from tasks.artifacts import sample_from_arrays, sample_to_arrays

UTM, ECEF = (500_000, 4_100_000, 300), (4_201_000.5, -168_770.25, 4_780_500)
PLACES = {
    "utm": (UTM, 1),
    "earth-centred": (ECEF, 1),
    "a kilometre east": ((1e3, 0, 0), 1),
    "utm in kilometres": ((500, 4100, 0.3), 1e-3),
    "millimetres": ((0, 0, 0), 1e3),
    "micrometres of kilometres": ((0, 0, 0), 1e-6),
}
TEXT = "red ball"


@cache
def home() -> Sample:
    """Return a room whose positions have six decimals, as those of a file."""
    scene = load("procedural", seed=1, views=3, height=120, width=160)
    sample = scene.sample(["view_00", "view_02"], ["view_01"])
    return _move(sample, lambda center: np.round(center, 6))


def far(place: str) -> Sample:
    offset, unit = PLACES[place]
    return _move(home(), lambda center: center * unit + offset)


def _move(sample: Sample, change) -> Sample:
    def move(view: View) -> View:
        c2w = view.camera.c2w.copy()
        c2w[:3, 3] = change(c2w[:3, 3])
        return replace(view, camera=replace(view.camera, c2w=c2w))

    parts = (tuple(map(move, views)) for views in (sample.context, sample.targets))
    return replace(sample, **dict(zip(("context", "targets"), parts, strict=True)))


@cache
def build_at(place: str | None) -> slg.SemanticField:
    return slg.build_field(home() if place is None else far(place))


def _views(place: str | None) -> list:
    sample = home() if place is None else far(place)
    cameras = [view.camera for view in (*sample.context, *sample.targets)]
    return [build_at(place).render(camera) for camera in cameras]


@pytest.mark.parametrize("place", PLACES)
def test_a_field_looks_and_answers_the_same_wherever_its_cameras_stand(place: str) -> None:
    offset, unit = PLACES[place]
    # Another unit rounds float32 otherwise, and near ties of labels fall the other way.
    bound = 1e-3 if unit == 1 else 5e-3
    for here, there in zip(_views(None), _views(place), strict=True):
        assert np.abs(here.rgb.astype(int) - there.rgb).max() <= 2
        assert (here.rgb != there.rgb).mean() < 1e-3
        assert np.median(np.abs(there.depth / unit / here.depth - 1)[here.depth > 0]) < 1e-6
        assert (here.ids != there.ids).mean() < bound
        asked = here.query(TEXT), there.query(TEXT)
        assert asked[0].point == asked[1].point
        assert abs(asked[0].score - asked[1].score) < 1e-6
    boxes = ([thing.box for thing in build_at(p).inventory()] for p in (None, place))
    for box, far_box in zip(*boxes, strict=True):
        np.testing.assert_allclose((far_box.centre - offset) / unit, box.centre, atol=5 * bound)


def test_a_far_field_draws_what_the_float64_reference_draws_at_home() -> None:
    here, there = home().context[0].camera, far("utm").context[0].camera
    small, small_far = here.resize(40, 30), there.resize(40, 30)
    gaussians = load_predictor("planesweep")(home())
    true = rasterize(gaussians, None, small, backend="reference")
    far_gaussians = load_predictor("planesweep")(far("utm"))
    for backend, bound in (("cpu", 0.01), ("reference", 1e-6)):  # the first has cut-offs
        drawn = rasterize(far_gaussians, None, small_far, backend=backend)
        assert (drawn.values - true.values).abs().max() < bound
        assert ((drawn.depth - true.depth) / true.depth).abs().median() < bound


def test_files_keep_the_world_of_a_far_field(tmp_path) -> None:
    field = build_at("earth-centred")
    field.save(tmp_path / "field")
    loaded = slg.SemanticField.load(tmp_path / "field")
    camera = far("earth-centred").targets[0].camera
    picture = field.render(camera).rgb
    np.testing.assert_array_equal(loaded.render(camera).rgb, picture)
    save_ply(field.gaussians, tmp_path / "scene.ply")
    read, _ = load_ply(tmp_path / "scene.ply")
    np.testing.assert_array_equal(read.origin, field.gaussians.origin)
    assert np.abs(np.subtract(ECEF, read.origin)).max() < 10 and abs(read.means).max() < 50
    with pytest.warns(UserWarning, match="no place for the origin"):
        save_spz(field.gaussians, tmp_path / "scene.spz")
    about = re.search(r'id="about">(.*?)</script>', scene_page(field), re.DOTALL)
    page = json.loads(about[1])
    for view, camera in zip(page["views"], field.cameras.values(), strict=True):
        there = np.array(view["c2w"])[:3, 3] + page["origin"]
        np.testing.assert_allclose(there, camera.center, rtol=0, atol=2e-9)


def test_a_ply_of_far_doubles_keeps_its_precision(tmp_path) -> None:
    save_ply(build_at(None).gaussians, tmp_path / "near.ply")
    table = PlyData.read(tmp_path / "near.ply")["vertex"].data
    kinds = [(name, "<f8" if name in "xyz" else table.dtype[name]) for name in table.dtype.names]
    doubles = table.astype(kinds)
    for name, shift in zip("xyz", UTM, strict=True):
        doubles[name] += shift
    PlyData([PlyElement.describe(doubles, "vertex")]).write(tmp_path / "far.ply")
    read, _ = load_ply(tmp_path / "far.ply")
    positions = read.means.numpy().astype(np.float64) + read.origin
    np.testing.assert_allclose(
        positions, np.stack([doubles[n] for n in "xyz"], 1), rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("place", ["utm", "earth-centred"])
def test_clips_and_samples_keep_far_cameras(place: str, tmp_path) -> None:
    views = {view.name: view for view in far(place).context}
    cameras = {name: view.camera for name, view in views.items()}
    re10k.write(tmp_path, [re10k.encode_clip(Scene("far", cameras, views.__getitem__))])
    read = list(re10k.read(tmp_path, "far").cameras.values())
    stored = sample_from_arrays(sample_to_arrays(far(place)))
    for camera, clip, view in zip(cameras.values(), read, stored.context, strict=True):
        np.testing.assert_allclose(clip.center, camera.center, rtol=0, atol=1e-5)
        np.testing.assert_array_equal(view.camera.c2w, camera.c2w)


def test_lessons_and_views_of_far_samples_are_in_the_frame_of_the_gaussians() -> None:
    gaussians = load_predictor("planesweep")(far("utm"))
    frames = see_targets(far("utm"), gaussians)
    assert max(np.abs(frame.view.camera.center).max() for frame in frames) < 10
    labels = np.zeros((2, 120, 160), np.int32)
    cameras = (far("utm").targets[0].camera,)
    lesson = Lesson("far", gaussians, labels, cameras, labels[:1])
    read = Lesson.from_arrays(lesson.to_arrays())
    drawn = rasterize(read.gaussians, gaussians.colours(), read.cameras[0]).values
    true = rasterize(gaussians, gaussians.colours(), cameras[0]).values
    assert (drawn - true).abs().max() < 1e-6


@pytest.mark.parametrize(
    ("positions", "origin"),
    [
        ([(0, 0, 0), (0.3, 0, 0)], (0, 0, 0)),
        ([(20, 0, 0), (20.3, 0, 0)], (0, 0, 0)),
        ([UTM, (500_000.3, 4_100_000, 300)], UTM),
        ([(500.0001, 4100, 0.3), (500.0004, 4100, 0.3)], (500, 4100, 0.3)),
        ([(7, -1e6, 0)] * 2, (0, -1e6, 0)),
        ([], (0, 0, 0)),
    ],
)
def test_local_origin_is_zero_or_a_round_point_near_far_positions(positions, origin) -> None:
    np.testing.assert_allclose(local_origin(positions), origin, rtol=0, atol=10)
    if not any(origin):
        assert not local_origin(positions).any()


def test_relative_to_gives_the_decimals_of_a_file_back() -> None:
    camera = Camera(np.diag([100.0, 100, 1]), np.eye(4), 8, 8)
    for position in ((-0.645693, 0.157158, 2.88225), (0.1, -0.7, 12.25)):
        c2w = np.eye(4)
        c2w[:3, 3] = np.add(position, ECEF)
        local = replace(camera, c2w=c2w).relative_to(np.array(ECEF, float))
        np.testing.assert_array_equal(local.center, position)
