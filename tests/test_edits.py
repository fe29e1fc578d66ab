"""What a user changes in a field: words, names, removed things. On a scene with an exact truth.

A wall of three colours, and a square in front of its middle that two cameras see from the sides.
"""

import dataclasses

import numpy as np
import pytest

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
    looked,
    square_field,
)


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return square_field("separated")


def inner(mask: np.ndarray, by: int = 3) -> np.ndarray:
    """A mask without what is within so many pixels of its border, in rows and columns."""
    padded = np.pad(mask, by)
    shifts = [np.roll(padded, (dy, dx), (0, 1)) for dy in (-by, 0, by) for dx in (-by, 0, by)]
    return np.logical_and.reduce(shifts)[by:-by, by:-by]


def test_a_click_in_one_view_teaches_a_word_for_another(field):
    x, y = 54, H // 2  # in view a the square is to the right of the middle
    id_ = int(field.render(field.cameras["a"]).ids[y, x])
    assert id_ == YELLOW
    hit = field.teach("zorp", id_).render(field.cameras["b"]).query("ZORP")
    truth = looked(field.cameras["b"])[0] == YELLOW
    assert hit.kind == "taught" and [one for one, _ in hit.objects] == [YELLOW]
    assert (hit.mask & truth).sum() / (hit.mask | truth).sum() > 0.8
    assert field.render(field.cameras["b"]).query("zorp").verdict == "cannot tell"


def test_every_change_leaves_the_field_as_it_was(field):
    changed = field.teach("zorp", RED).named(BLUE, "Sea").without([YELLOW])
    assert not len(field.taught) and not field.names and not field.removed
    assert changed.names == {BLUE: "Sea"} and changed.removed == {YELLOW}
    back = changed.forget("zorp").named(BLUE, " ").restored([YELLOW])
    a, b = (one.render(field.cameras["a"]) for one in (field, back))
    for name in ("rgb", "ids", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert not len(back.taught) and back.names == {}


def test_what_was_behind_is_shown_where_a_view_saw_it_and_open_elsewhere(field):
    open_field = field.without([YELLOW])
    cam = camera(0.0)
    behind, _ = looked(cam, square=False)
    points = cam.unproject(np.full((H, W), WALL))
    seen = np.zeros((H, W), bool)
    for context in field.cameras.values():
        pixels, _ = context.project(points)
        u, v = np.floor(pixels).astype(int).transpose(2, 0, 1)
        within = (u >= 0) & (u < W) & (v >= 0) & (v < H)
        labels, _ = looked(context)
        seen |= within & (labels[v.clip(0, H - 1), u.clip(0, W - 1)] != YELLOW)
    view = open_field.render(cam)
    known, hidden = inner(seen), inner(~seen)
    assert hidden.any() and (known & (looked(cam)[0] == YELLOW)).any()
    assert view.unknown[hidden].all() and not view.unknown[known].any()
    for id_ in (RED, GREEN, BLUE):
        assert (view.ids[inner(seen & (behind == id_))] == id_).all()
    assert not view.ids[hidden].any()
    shades = view.rgb[hidden]
    assert (shades == shades[:, :1]).all() and len(np.unique(shades)) == 2  # stripes of two greys
    assert not field.render(cam).unknown[looked(cam)[0] == YELLOW].any()


def test_a_second_removal_draws_no_view_again(field, monkeypatch):
    both, one = field.without([YELLOW, GREEN]).gone, field.without([YELLOW])
    assert one.gone.any() and not np.array_equal(one.gone, both)
    monkeypatch.setattr(SemanticField, "render", None)
    np.testing.assert_array_equal(one.named(RED, "Sun").without([GREEN]).gone, both)


def test_what_is_removed_is_not_an_answer(field):
    open_field = field.teach("zorp", YELLOW).without([YELLOW])
    view = open_field.render(field.cameras["a"])
    assert YELLOW not in view.ids
    for text in ("yellow", "zorp"):
        assert YELLOW not in [id_ for id_, _ in view.query(text).objects]
    assert [one.id for one in open_field.inventory(["red"])] == [RED, GREEN, BLUE]
    assert open_field.drawn is open_field.drawn and len(open_field.drawn) < len(field.gaussians)


def test_a_name_means_the_object_that_has_it_and_no_other(field, tmp_path):
    folder = tmp_path / "field"
    named = field.named(GREEN, "Die  Wiese").named(BLUE, "red").named(RED, "sides")
    named = named.named(YELLOW, "sides").teach("die wiese", YELLOW)
    named.save(folder)
    for own in (named, SemanticField.load(folder)):
        view = own.render(own.cameras["a"])
        hit = view.query(" die WIESE ")
        assert [id_ for id_, _ in hit.objects] == [GREEN]
        assert (hit.mask == (view.ids == GREEN)).all()
        assert (hit.kind, hit.verdict, hit.confidence) == ("named", "found", None)
        assert hit.score == pytest.approx(1, abs=1e-3) and hit.understood.examples == 0
        assert own.find("die wiese") == hit.objects
        # A name wins over what the encoder knows, which is said; and two may have the same.
        red = view.query("red", threshold=0.99, temperature=1)
        assert [id_ for id_, _ in red.objects] == [BLUE] and red.understood.instead_of == "red"
        assert {id_ for id_, _ in view.query("sides").objects} == {RED, YELLOW}
        segments = view.segment(["green", "die wiese", "yellow"])
        assert (segments[view.ids == GREEN] == 2).all()
    away = named.without([GREEN])
    hit = away.render(away.cameras["a"]).query("die wiese")
    assert not hit.found and hit.verdict == "not here" and away.find("die wiese") == ()
    assert named.named(GREEN, "").render(named.cameras["a"]).query("die wiese").kind == "taught"


def test_only_some_objects(field):
    alone = field.only([YELLOW])
    assert set(alone.labels().tolist()) == {YELLOW}
    assert len(alone.gaussians) == (field.labels() == YELLOW).sum()
    assert set(np.unique(alone.render(field.cameras["a"]).ids)) == {0, YELLOW}


def test_ask_by_picture(field):
    view = field.render(field.cameras["b"])
    crop = np.full((20, 20, 3), COLOURS[BLUE], np.uint8)
    hit = view.like(crop)
    assert hit.objects[0][0] == BLUE
    # A cut-out: what lies around the thing plays no part.
    around = np.full((3 * crop.shape[0], 3 * crop.shape[1], 3), (200, 10, 10), np.uint8)
    where = np.zeros(around.shape[:2], bool)
    where[crop.shape[0] : 2 * crop.shape[0], crop.shape[1] : 2 * crop.shape[1]] = True
    around[where] = crop.reshape(-1, 3)
    assert view.like(around, where).objects[0][0] == BLUE
    assert np.array_equal(view.like(around, where).scores, hit.scores)
    assert not np.array_equal(view.like(around).scores, hit.scores)
    assert hit.kind == "picture" and hit.point is not None
    assert view.ids[hit.point[1], hit.point[0]] == BLUE


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda image, mask: (image / 255, mask), r"found float64 \(9, 8, 3\), expected uint8"),
        (lambda image, mask: (image[..., [0, 1, 2, 0]], mask), r"found uint8 \(9, 8, 4\)"),
        (lambda image, mask: (image, mask[:5]), r"its mask is bool \(5, 8\), expected bool \(9, 8"),
        (lambda image, mask: (image, mask & False), "its mask is empty"),
    ],
)
def test_a_picture_or_mask_of_another_kind_is_refused(field, change, message):
    image, mask = change(np.zeros((9, 8, 3), np.uint8), np.ones((9, 8), bool))
    with pytest.raises(InputError, match=message):
        field.picture_words(image, mask)


def test_edits_are_saved_beside_the_field_and_taken_away_again(field, tmp_path):
    folder = tmp_path / "field"
    field.save(folder, {"photographs.json": b"{}"})
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    changed = field.teach("zorp", RED).teach("zorp", BLUE)
    changed = changed.named(GREEN, "Die Wiese").without([YELLOW])
    changed.save_edits(folder)
    again = SemanticField.load(folder)
    assert again.names == {GREEN: "Die Wiese"} and again.removed == {YELLOW}
    assert again.taught.examples("zorp") == 2
    one, other = (f.render(f.cameras["a"]).query("zorp") for f in (changed, again))
    np.testing.assert_array_equal(one.scores, other.scores)
    for name, data in before.items():
        assert (folder / name).read_bytes() == data
    changed.save(tmp_path / "whole")
    for name in ("words.npz", "edits.npz"):
        assert (tmp_path / "whole" / name).read_bytes() == (folder / name).read_bytes()
    field.save_edits(folder)
    assert {file.name for file in folder.iterdir()} == set(before)


@pytest.mark.parametrize("name", ["words.npz", "edits.npz"])
def test_damaged_edits_are_one_sentence(field, tmp_path, name):
    field.teach("zorp", RED).without([BLUE]).save(tmp_path / "field")
    file = tmp_path / "field" / name
    file.write_bytes(file.read_bytes()[:-30])
    with pytest.raises(SpecError, match=name):
        SemanticField.load(tmp_path / "field")


def test_edits_of_other_fields_are_refused(field, tmp_path):
    few = dataclasses.replace(field, removed=frozenset([99]))
    few.save(tmp_path / "field")
    with pytest.raises(SpecError, match=r"edits\.npz: object 99 is not in this field"):
        SemanticField.load(tmp_path / "field")
    bank = dataclasses.replace(field.bank, ids=field.bank.ids + 1)
    with pytest.raises(InputError, match="is the folder of another field"):
        field.changed(bank=bank).save_edits(tmp_path / "field")


@pytest.mark.parametrize("method", ["without", "restored", "only"])
def test_objects_that_are_not_there_are_refused(field, method):
    with pytest.raises(InputError, match="object 5: is not in the field, which has 4 objects"):
        getattr(field, method)([RED, 5])
    for call in (lambda: field.teach("zorp", 5), lambda: field.named(5, "x")):
        with pytest.raises(InputError, match="object 5"):
            call()


def test_what_was_dropped_cannot_come_back(field):
    dropped = field.without([YELLOW])
    dropped = dropped.changed(gaussians=dropped.drawn)
    assert dropped.render(field.cameras["a"]).unknown.any()
    with pytest.raises(InputError, match="object 11: its Gaussians are not in this field"):
        dropped.restored([YELLOW])


def test_the_inventory_says_what_there_is(field):
    changed = field.teach("zorp", RED).named(BLUE, "Sea").without([GREEN])
    things = {one.id: one for one in changed.inventory()}
    assert list(things) == [RED, BLUE, YELLOW]
    assert things[RED].words[0][0] == "zorp" and things[BLUE].name == "Sea"
    assert "blue" in [text for text, _ in things[BLUE].words]
    square = things[YELLOW]
    assert square.gaussians == (field.labels() == YELLOW).sum() and square.views == ("a", "b")
    np.testing.assert_allclose(square.box.centre, [0, 0, NEAR], atol=0.04)
    np.testing.assert_allclose(np.sort(square.box.half_sizes), [0, HALF, HALF], atol=0.03)
    assert square.confidence > 0.8 and square.metres is None
    told = field.inventory(["yellow", "blue"])[-1]
    assert [text for text, _ in told.words] == ["yellow", "blue"]
    assert told.words[0][1] > 0.5 > told.words[1][1]
