"""Edits of a field: taught words, names and removed objects, on a scene of known geometry.

Two cameras see from the sides a wall of three colours with a square in front of its middle.
"""

import dataclasses

import numpy as np
import pytest

from slgaussian.edits import Edits
from slgaussian.errors import InputError, SpecError
from slgaussian.field import SemanticField
from tests.square import (
    BLUE,
    COLOURS,
    GREEN,
    HALF,
    NEAR,
    RED,
    WALL,
    YELLOW,
    H,
    W,
    camera,
    label_view,
    square_field,
)


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return square_field("separated")


def erode(mask: np.ndarray, radius: int = 3) -> np.ndarray:
    """Remove from a mask the pixels within ``radius`` rows and columns of its border."""
    padded = np.pad(mask, radius)
    steps = (-radius, 0, radius)
    shifts = [np.roll(padded, (dy, dx), (0, 1)) for dy in steps for dx in steps]
    return np.logical_and.reduce(shifts)[radius:-radius, radius:-radius]


def test_word_taught_by_a_click_is_found_in_another_view(field):
    x, y = 54, H // 2  # in view a the square is to the right of the middle
    id_ = int(field.render(field.cameras["a"]).ids[y, x])
    assert id_ == YELLOW
    hit = field.teach("zorp", id_).render(field.cameras["b"]).query("ZORP")
    truth = label_view(field.cameras["b"])[0] == YELLOW
    assert hit.kind == "taught" and [id_ for id_, _ in hit.objects] == [YELLOW]
    assert (hit.mask & truth).sum() / (hit.mask | truth).sum() > 0.8
    assert field.render(field.cameras["b"]).query("zorp").verdict == "cannot tell"


def test_undo_of_all_edits_restores_the_original_renderings(field):
    edited = field.teach("zorp", RED).rename(BLUE, "Sea").without([YELLOW])
    assert not len(field.edits.taught) and not field.edits.names and not field.edits.removed
    assert edited.edits.names == {BLUE: "Sea"} and edited.edits.removed == {YELLOW}
    undone = edited.forget("zorp").rename(BLUE, " ").restore([YELLOW])
    a, b = (version.render(field.cameras["a"]) for version in (field, undone))
    for name in ("rgb", "ids", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert not len(undone.edits.taught) and undone.edits.names == {}


def test_removal_shows_observed_background_and_stripes_elsewhere(field):
    edited, cam = field.without([YELLOW]), camera(0.0)
    behind, _ = label_view(cam, square=False)
    points = cam.unproject(np.full((H, W), WALL))
    observed = np.zeros((H, W), bool)
    for context in field.cameras.values():
        pixels, _ = context.project(points)
        u, v = np.floor(pixels).astype(int).transpose(2, 0, 1)
        within = (u >= 0) & (u < W) & (v >= 0) & (v < H)
        labels, _ = label_view(context)
        observed |= within & (labels[v.clip(0, H - 1), u.clip(0, W - 1)] != YELLOW)
    view = edited.render(cam)
    visible, hidden = erode(observed), erode(~observed)
    assert hidden.any() and (visible & (label_view(cam)[0] == YELLOW)).any()
    assert view.unknown[hidden].all() and not view.unknown[visible].any()
    for id_ in (RED, GREEN, BLUE):
        assert (view.ids[erode(observed & (behind == id_))] == id_).all()
    assert not view.ids[hidden].any()
    shades = view.rgb[hidden]
    assert (shades == shades[:, :1]).all() and len(np.unique(shades)) == 2  # stripes of two greys
    assert not field.render(cam).unknown[label_view(cam)[0] == YELLOW].any()


def test_second_removal_renders_no_view(field, monkeypatch):
    both, first = field.without([YELLOW, GREEN]).hidden, field.without([YELLOW])
    assert first.hidden.any() and not np.array_equal(first.hidden, both)
    monkeypatch.setattr(SemanticField, "render", None)
    np.testing.assert_array_equal(first.rename(RED, "Sun").without([GREEN]).hidden, both)


def test_removed_objects_are_no_answers(field):
    edited = field.teach("zorp", YELLOW).without([YELLOW])
    view = edited.render(field.cameras["a"])
    assert YELLOW not in view.ids
    for text in ("yellow", "zorp"):
        assert YELLOW not in [id_ for id_, _ in view.query(text).objects]
    assert [item.id for item in edited.inventory(["red"])] == [RED, GREEN, BLUE]
    assert edited.visible is edited.visible and len(edited.visible) < len(field.gaussians)


def test_name_selects_exactly_the_objects_that_have_it(field, tmp_path):
    named = field.rename(GREEN, "Die  Wiese").rename(BLUE, "red").rename(RED, "sides")
    named = named.rename(YELLOW, "sides").teach("die wiese", YELLOW)
    named.save(tmp_path / "field")
    for version in (named, SemanticField.load(tmp_path / "field")):
        view = version.render(version.cameras["a"])
        hit = view.query(" die WIESE ")
        assert [id_ for id_, _ in hit.objects] == [GREEN]
        assert (hit.mask == (view.ids == GREEN)).all()
        assert (hit.kind, hit.verdict, hit.confidence) == ("named", "found", None)
        assert hit.score == pytest.approx(1, abs=1e-3) and hit.understood.examples == 0
        assert version.find("die wiese") == hit.objects
        # A name takes precedence over the encoder's word, and the answer reports it.
        red = view.query("red", threshold=0.99, temperature=1)
        assert [id_ for id_, _ in red.objects] == [BLUE] and red.understood.instead_of == "red"
        assert {id_ for id_, _ in view.query("sides").objects} == {RED, YELLOW}
        segments = view.segment(["green", "die wiese", "yellow"])
        assert (segments[view.ids == GREEN] == 2).all()
    removed = named.without([GREEN])
    hit = removed.render(removed.cameras["a"]).query("die wiese")
    assert not hit.found and hit.verdict == "not here" and removed.find("die wiese") == ()
    assert named.rename(GREEN, "").render(named.cameras["a"]).query("die wiese").kind == "taught"


def test_only_keeps_the_chosen_objects(field):
    subset = field.only([YELLOW])
    assert set(subset.labels().tolist()) == {YELLOW}
    assert len(subset.gaussians) == (field.labels() == YELLOW).sum()
    assert set(np.unique(subset.render(field.cameras["a"]).ids)) == {0, YELLOW}


def test_picture_query_ignores_pixels_outside_its_mask(field):
    view = field.render(field.cameras["b"])
    crop = np.full((20, 20, 3), COLOURS[BLUE], np.uint8)
    hit = view.like(crop)
    assert hit.objects[0][0] == BLUE and hit.kind == "picture"
    assert hit.point is not None and view.ids[hit.point[1], hit.point[0]] == BLUE
    picture = np.full((60, 60, 3), (200, 10, 10), np.uint8)
    mask = np.zeros(picture.shape[:2], bool)
    mask[20:40, 20:40] = True
    picture[mask] = crop.reshape(-1, 3)
    masked = view.like(picture, mask)
    assert masked.objects[0][0] == BLUE and np.array_equal(masked.scores, hit.scores)
    assert not np.array_equal(view.like(picture).scores, hit.scores)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda image, mask: (image / 255, mask), r"found float64 \(9, 8, 3\), expected uint8"),
        (lambda image, mask: (image[..., [0, 1, 2, 0]], mask), r"found uint8 \(9, 8, 4\)"),
        (lambda image, mask: (image, mask[:5]), r"its mask is bool \(5, 8\), expected bool \(9, 8"),
        (lambda image, mask: (image, mask & False), "its mask is empty"),
    ],
    ids=["float image", "four channels", "mask of another size", "empty mask"],
)
def test_like_raises_input_error_for_an_invalid_picture_or_mask(field, change, message):
    image, mask = change(np.zeros((9, 8, 3), np.uint8), np.ones((9, 8), bool))
    with pytest.raises(InputError, match=message):
        field.render(field.cameras["a"]).like(image, mask)


def test_save_edits_writes_only_files_of_edits(field, tmp_path):
    folder = tmp_path / "field"
    field.save(folder, {"photographs.json": b"{}"})
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    edited = field.teach("zorp", RED).teach("zorp", BLUE)
    edited = edited.rename(GREEN, "Die Wiese").without([YELLOW])
    edited.save_edits(folder)
    restored = SemanticField.load(folder)
    assert restored.edits.names == {GREEN: "Die Wiese"} and restored.edits.removed == {YELLOW}
    assert restored.edits.taught.examples("zorp") == 2
    scores = [f.render(f.cameras["a"]).query("zorp").scores for f in (edited, restored)]
    np.testing.assert_array_equal(*scores)
    for name, data in before.items():
        assert (folder / name).read_bytes() == data
    edited.save(tmp_path / "saved at once")
    for name in ("words.npz", "edits.npz"):
        assert (tmp_path / "saved at once" / name).read_bytes() == (folder / name).read_bytes()
    field.save_edits(folder)
    assert {file.name for file in folder.iterdir()} == set(before)


def test_edits_of_another_field_raise_errors(field, tmp_path):
    dataclasses.replace(field, edits=Edits(removed=frozenset([99]))).save(tmp_path / "field")
    with pytest.raises(SpecError, match=r"edits\.npz: object 99 is not in this field"):
        SemanticField.load(tmp_path / "field")
    bank = dataclasses.replace(field.bank, ids=field.bank.ids + 1)
    with pytest.raises(InputError, match="is the folder of another field"):
        field.with_changes(bank=bank).save_edits(tmp_path / "field")


@pytest.mark.parametrize(
    "edit",
    [
        lambda field: field.without([RED, 5]),
        lambda field: field.restore([RED, 5]),
        lambda field: field.only([RED, 5]),
        lambda field: field.teach("zorp", 5),
        lambda field: field.rename(5, "x"),
    ],
    ids=["without", "restore", "only", "teach", "named"],
)
def test_edit_of_an_absent_object_raises_input_error(field, edit):
    with pytest.raises(InputError, match="object 5: is not in the field, which has 4 objects"):
        edit(field)


def test_restore_raises_input_error_without_gaussians(field):
    dropped = field.without([YELLOW])
    dropped = dropped.drop_hidden()
    assert dropped.render(field.cameras["a"]).unknown.any()
    with pytest.raises(InputError, match="object 11: its Gaussians are not in this field"):
        dropped.restore([YELLOW])


def test_inventory_lists_words_names_views_and_boxes(field):
    edited = field.teach("zorp", RED).rename(BLUE, "Sea").without([GREEN])
    items = {item.id: item for item in edited.inventory()}
    assert list(items) == [RED, BLUE, YELLOW]
    assert items[RED].words[0][0] == "zorp" and items[BLUE].name == "Sea"
    assert "blue" in [text for text, _ in items[BLUE].words]
    square = items[YELLOW]
    assert square.gaussians == (field.labels() == YELLOW).sum() and square.views == ("a", "b")
    np.testing.assert_allclose(square.box.centre, [0, 0, NEAR], atol=0.04)
    np.testing.assert_allclose(np.sort(square.box.half_sizes), [0, HALF, HALF], atol=0.03)
    assert square.confidence > 0.8 and square.metres is None
    (best, score), (second, lower) = field.inventory(["yellow", "blue"])[-1].words
    assert (best, second) == ("yellow", "blue") and score > 0.5 > lower
