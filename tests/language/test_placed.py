"""Answers about where things are, in a drawn room where every thing and its place is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.labels import LabelMaps
from slgaussian.language.confidence import Calibration
from slgaussian.language.query import Rules, ask
from slgaussian.parts.method import Method
from slgaussian.scene import Camera, Sample, View
from tests.known import known_field

H, W, FOCAL = 96, 144, 130.0
GREY, RED, BLUE, GREEN, BLACK = (
    np.array(c, np.uint8)
    for c in ((150, 150, 150), (200, 30, 30), (30, 40, 190), (20, 140, 40), (15, 15, 15))
)
THINGS = {
    # id: colour, x from and to, y from and to (y is down), z; in metres
    2: (RED, (-1.9, -1.2), (0.3, 1.0), 4.0),
    3: (RED, (1.0, 1.4), (0.6, 1.0), 4.0),
    4: (BLUE, (-0.5, 0.5), (0.2, 1.0), 3.4),
    5: (RED, (-0.2, 0.2), (-0.2, 0.19), 3.4),
    6: (GREEN, (1.9, 2.3), (-1.2, -0.7), 5.0),
    7: (RED, (-1.2, -0.9), (0.3, 1.0), 4.02),  # the other piece of thing 2
}
BACK = 6.0


def camera(x: float) -> Camera:
    c2w = np.eye(4)
    c2w[0, 3] = x
    return Camera(np.array([[FOCAL, 0, W / 2], [0, FOCAL, H / 2], [0, 0, 1]]), c2w, W, H)


def drawn(cam: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture, labels and depths of plates before a wall."""
    depth, labels = np.full((H, W), BACK), np.ones((H, W), np.int32)
    image = np.broadcast_to(GREY, (H, W, 3)).copy()
    for id_, (colour, xs, ys, z) in sorted(THINGS.items(), key=lambda one: -one[1][3]):
        at = cam.unproject(np.full((H, W), z))
        inside = (at[..., 0] >= xs[0]) & (at[..., 0] < xs[1])
        inside &= (at[..., 1] >= ys[0]) & (at[..., 1] < ys[1]) & (z < depth)
        depth[inside], labels[inside], image[inside] = z, id_, colour
    return image, labels, depth


def room(mirrored: bool = False) -> SemanticField:
    cameras = {"a": camera(-0.1), "b": camera(0.1)}
    seen = [drawn(cam) for cam in cameras.values()]
    points = [
        c.unproject(d).reshape(-1, 3) for c, (*_, d) in zip(cameras.values(), seen, strict=True)
    ]
    if mirrored:
        seen = [tuple(one[:, ::-1].copy() for one in three) for three in seen[::-1]]
        points = [(p.reshape(H, W, 3)[:, ::-1] * [-1, 1, 1]).reshape(-1, 3) for p in points[::-1]]
    views = [View(name, cameras[name], image) for name, (image, *_) in zip("ab", seen, strict=True)]
    labels = np.stack([labels for _, labels, _ in seen])
    where = np.concatenate(points)
    n = len(where)
    colours = np.concatenate([image.reshape(-1, 3) for image, *_ in seen]) / 255
    spread = np.concatenate([(0.6 * depth / FOCAL).ravel() for *_, depth in seen])
    gaussians = Gaussians(
        means=torch.tensor(where, dtype=torch.float32),
        scales=torch.tensor(spread, dtype=torch.float32)[:, None].expand(n, 3).contiguous(),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        opacities=torch.full((n,), 0.95),
        sh=rgb_to_sh(torch.tensor(colours, dtype=torch.float32)),
        source=torch.arange(n, dtype=torch.int32),
    )
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    return known_field(
        Sample("plates", tuple(views)), gaussians, maps, Method(codes="exact", keep="all")
    )


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return room()


@pytest.fixture(scope="module")
def view(field):
    return field.render(field.cameras["a"])


def ids(hit):
    return {id_ for id_, _ in hit.objects}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("red", {2, 3, 5, 7}),
        ("red left of the blue", {2, 7}),
        ("red right of the blue", {3}),
        ("red above the blue", {5}),
        ("red on the blue", {5}),
        ("blue below the red on the blue", {4}),
        ("green behind the blue", set()),
        ("red next to the green", set()),
        ("red next to the blue", {2, 7, 5}),
        ("largest red", {2, 7}),
        ("smallest red", {5}),
        ("nearest red", {5}),
        ("leftmost red", {2, 7}),
        ("rightmost red", {3}),
        ("highest red", {5}),
        ("red nearest to the green", {3}),
        ("red farthest from the green", {2, 7}),
        ("leftmost red right of the largest red", {5}),
        ("how many reds are there", {2, 3, 5, 7}),
    ],
)
def test_the_things_that_lie_so_are_found(view, text, expected):
    hit = view.query(text)
    assert ids(hit) == expected, hit.notes
    assert hit.text == text
    truth = np.isin(view.ids, list(expected))
    np.testing.assert_array_equal(hit.mask, truth)
    assert hit.found == bool(expected)
    if expected:
        assert truth[hit.point[1], hit.point[0]]
        assert hit.relevancy[truth].min() > 0.5
    else:
        assert hit.verdict == "not here" and hit.notes
    # What fits the word and lies elsewhere is no longer relevant.
    assert hit.relevancy[~truth].max() <= 0.5


def test_pieces_of_one_thing_count_once(view):
    hit = view.query("how many reds")
    assert hit.count == 3
    assert any("touch" in note for note in hit.notes)
    two = view.query("two reds")
    assert two.count == 2 and not any("found, not" in note for note in two.notes)
    five = view.query("five reds")
    assert five.count == 3 and "3 found, not 5" in five.notes
    assert view.query("how many yellows").count == 0


def test_that_there_are_several_does_not_speak_against_their_count(view, monkeypatch):
    known = view.reader.encoder.calibration
    harsh = Calibration(replace(known.mask, parts=-50.0), replace(known.point, parts=-50.0))
    monkeypatch.setattr(type(view.reader.encoder), "calibration", harsh)
    assert view.query("red").verdict == "not here"
    assert view.query("how many reds").count == 3


def test_a_mirrored_room_mirrors_left_and_right(view):
    other = room(mirrored=True)
    mirrored = other.render(other.cameras["b"])
    for text, swapped in [
        ("red left of the blue", "red right of the blue"),
        ("leftmost red", "rightmost red"),
        ("red above the blue", "red above the blue"),
        ("largest red", "largest red"),
    ]:
        assert ids(view.query(text)) == ids(mirrored.query(swapped)) != set()


def test_what_a_relation_is_to_must_be_there(view):
    hit = view.query("red left of the yellow")
    assert not hit.found and "'yellow' is probably not here" in hit.notes
    with pytest.raises(InputError, match="quixotic"):
        view.query("red left of the quixotic")
    with pytest.raises(InputError, match="not answered: only one of largest and nearest"):
        view.query("largest nearest red")


def test_texts_that_say_nothing_of_places_answer_as_before(field, view):
    texts = ["red", "blue", "red on the left", "green wall", "things", "red picture of a blue"]
    before = ask(texts, view._objects, field.reader, Rules())
    among = view.query_all([*texts, "red left of the blue"])[:-1]
    for old, new, mixed in zip(before, view.query_all(texts), among, strict=True):
        for one in (new, mixed):
            assert old.scores.tobytes() == one.scores.tobytes()
            assert old.mask.tobytes() == one.mask.tobytes()
            assert (old.point, old.objects, old.confidence) == (
                one.point,
                one.objects,
                one.confidence,
            )
            assert (old.understood, one.count, one.notes) == (one.understood, None, ())


def test_what_is_understood_is_told_of_both_things(field):
    read = field.reader.meant("largest red quixotic left of the blue zorp")
    assert read.read_as == "largest red left of blue"
    assert read.unknown == ("quixotic", "zorp")
    assert field.reader.meant("red ball") == field.reader.understood("red ball")


def test_a_name_is_no_sentence(field):
    named = field.named(3, "red left of the blue")
    hit = named.render(named.cameras["a"]).query("red left of the blue")
    assert ids(hit) == {3} and hit.kind == "named"


def test_whatever_the_view_the_first_camera_decides(field):
    assert {id_ for id_, _ in field.find("red left of the blue")} == {2, 7}
    assert {id_ for id_, _ in field.find("largest red")} == {2, 7}
    gone = field.without([2, 7])
    assert {id_ for id_, _ in gone.find("red left of the blue")} == set()
    assert gone.render(gone.cameras["a"]).query("how many reds").count == 2


@pytest.mark.parametrize("rules", [{"protocol": "langsplat"}, {"threshold": 0.55}, {"share": 1.0}])
def test_any_rules_take_what_lies_so(view, rules):
    hit = view.query("red left of the blue", **rules)
    x, y = hit.point
    assert view.ids[y, x] in (2, 7)
    assert not view.query("red left of the yellow", **rules).found
    assert not view.query("green left of the blue", **rules).found
