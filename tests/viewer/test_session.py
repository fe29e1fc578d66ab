"""What is asked, shown and changed in a session, without a browser. On a scene with exact truth."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from slgaussian.errors import InputError, SpecError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.language.query import Rules
from slgaussian.viewer import paint, shots, told
from slgaussian.viewer.outline import Outlines
from slgaussian.viewer.session import Session
from slgaussian.viewer.stage import DEPTH, Stand
from tests.square import BLUE, COLOURS, GREEN, RED, YELLOW, H, W, square_field


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "wall"
    square_field("separated").save(path)
    return path


@pytest.fixture
def session(folder) -> Session:
    return Session(folder)


def test_a_window_sees_what_a_camera_sees(session):
    stage = session.stage
    for camera in session.cameras.values():
        again = stage.camera(stage.stand(camera, W / H), W, H)
        np.testing.assert_allclose(again.K, camera.K, rtol=1e-12)
        np.testing.assert_allclose(again.c2w, camera.c2w, atol=1e-12)
        # All of the picture is in the window, whatever its shape, and wherever its middle is.
        for aspect, du, dv in ((0.5, 0, 0), (2.0, 0, 0), (0.5, 0.4, 0), (2.0, -0.8, 0.3)):
            camera = replace(camera, K=camera.K + [[0, 0, du * W], [0, 0, dv * H], [0, 0, 0]])
            wide = stage.camera(stage.stand(camera, aspect), round(400 * aspect), 400)
            corners = camera.unproject(np.full((H, W), 1.0))[[0, 0, -1, -1], [0, -1, 0, -1]]
            pixels, _ = wide.project(corners)
            assert (pixels >= 0).all() and (pixels <= (wide.width, wide.height)).all()


def test_the_stage_has_its_size_and_its_up(session):
    z = session.cameras["a"].project(session.gaussians.means.numpy().astype(float))[1]
    assert np.median(z) * session.stage.scale == pytest.approx(DEPTH, rel=0.05)
    np.testing.assert_allclose(session.stage.up, [0, -1, 0], atol=1e-12)


def test_large_windows_give_smaller_pictures_of_the_same_view(session):
    stand = Stand(np.array([1.0, 0, 0, 0]), np.zeros(3), 0.8)
    small, large = (session.stage.camera(stand, k * 800, k * 500) for k in (1, 8))
    assert (large.width, large.height) == (1280, 800)
    np.testing.assert_allclose(large.K[0, 0] / large.width, small.K[0, 0] / small.width)


@pytest.mark.parametrize(("x", "y", "id_"), [(54, 30, YELLOW), (5, 5, RED), (77, 55, BLUE)])
def test_a_click_finds_what_is_there(session, x, y, id_):
    camera = session.cameras["a"]
    true = int(session.field.render(camera).ids[y, x])
    assert true == id_
    assert session.click(camera, x + 0.5, y + 0.5) == session.look.selected == true


def test_a_click_past_everything_selects_nothing(session):
    session.click(session.cameras["a"], 54, 30)
    away = replace(session.cameras["a"], c2w=np.diag([-1.0, 1, -1, 1]))
    assert session.click(away, 40, 30) == 0
    assert "Click a thing" in told.thing(session)


def test_what_is_clicked_has_an_outline(session):
    plain = session.colours().astype(int)
    session.click(session.cameras["a"], 54, 30)
    shown, own = session.colours(), session.labels == YELLOW
    labels = session.labels.reshape(2, H, W)  # a Gaussian a pixel
    beside = np.zeros(labels.shape, bool)
    for view, y, x in zip(*np.nonzero(labels == YELLOW), strict=True):
        around = labels[view, max(0, y - 2) : y + 3, max(0, x - 2) : x + 3]
        beside[view, y, x] = (around != YELLOW).any()
    outline = beside.ravel()
    assert 0 < outline.sum() < own.sum() / 2
    assert (shown[outline] == paint.SELECTED).all()
    assert (shown[~own] == plain[~own]).all()
    inner = np.abs(shown[own & ~outline] - plain[own & ~outline]).max(1)
    assert (inner > 10).all() and (inner < 60).all()
    some = np.arange(len(plain)) % 3 > 0
    kept = Outlines(session.labels[some], session.gaussians.source.numpy()[some], (2, H, W))
    assert 0.5 < kept.of(YELLOW).sum() / outline.sum() < 0.8, "also where pixels have no Gaussian"


def test_a_word_lights_up_what_it_finds_and_nothing_else(session):
    before = session.colours()
    answer = session.ask(["red"], Rules())
    (hit,) = answer.hits
    assert session.look.mode == "relevancy" and hit.objects[0][0] == RED
    lit, taken = session.colours(), session.labels == RED
    assert (hit.mask[0] == taken).all()
    assert lit[taken].sum(1).min() > lit[~taken].sum(1).max()
    said = told.answer(session)
    assert f"score {hit.score:.3f}" in said and "known" in said and f"object {RED}" in said
    session.ask([], Rules())
    assert (session.colours() == before).all() and told.answer(session) == ""


def test_a_threshold_and_a_temperature_are_heard(session):
    near = session.ask(["red"], Rules()).hits[0]
    all_of_it = session.ask(["red"], Rules(threshold=0.05)).hits[0]
    assert len(all_of_it.objects) > len(near.objects)
    assert session.ask(["red"], Rules(temperature=2)).hits[0].score < near.score


def test_several_words_part_the_scene_with_a_legend(session):
    answer = session.ask(["blue", "red", "xyzzy"], Rules())
    assert list(answer.refused) == ["xyzzy"]
    winner = answer.winner()
    assert (winner[session.labels == BLUE] == 1).all() and (
        winner[session.labels == RED] == 2
    ).all()
    said = told.answer(session)
    assert "xyzzy" in said and "refused" in said and said.count("&#9632;") == 2
    colours = session.colours()
    for number, id_ in ((1, BLUE), (2, RED)):
        shade = colours[session.labels == id_].astype(float)
        legend = paint.pictures.label_colors(np.array(number)).astype(float)
        across = np.linalg.norm(np.cross(shade, legend), axis=1)
        assert (across / np.linalg.norm(shade, axis=1) / np.linalg.norm(legend) < 0.05).all()


def test_every_mode_paints_what_it_says(session):
    camera = session.cameras["a"]
    session.show("colour")
    for id_, colour in COLOURS.items():
        assert (np.abs(session.colours()[session.labels == id_].astype(int) - colour) <= 1).all()
    session.show("objects")
    assert len(np.unique(session.colours(), axis=0)) == 4
    session.show("code")
    bank = session.field.bank
    for id_, code in zip(bank.ids, bank.codes, strict=True):
        assert (np.abs(session.colours()[session.labels == id_] - 255 * code) <= 1).all()
    session.show("depth", camera)
    square, wall = (session.colours()[session.labels == id_][0] for id_ in (YELLOW, RED))
    assert square[0] > square[2] and wall[2] > wall[0]  # red is near, blue is far
    with pytest.raises(InputError, match="mode"):
        session.show("sound")


def test_what_is_a_guess_and_what_is_unsure_is_marked(session):
    guessed = torch.zeros(len(session.gaussians), dtype=torch.bool)
    guessed[::7] = True
    session.gaussians = replace(session.gaussians, guessed=guessed)
    plain = session.colours()
    session.mark(guesses=True, unsure=False)
    changed = (session.colours() != plain).any(1)
    assert (changed == guessed.numpy()).all()
    assert "14 %" in told.marks(session)
    for name in session.cameras:
        session.look_through(name)
    session.mark(guesses=False, unsure=True)
    unsure = (session.colours() != plain).any(1)
    # Only beside the borders of objects are labels not sure.
    assert 0 < unsure.mean() < 0.3
    border = session.field.render(session.cameras["a"]).confidence.ravel() < 0.5
    mine = session.gaussians.source.numpy() < H * W
    assert (unsure[mine] == border[session.gaussians.source.numpy()[mine]]).all()


def test_the_picture_is_that_of_the_field(session):
    camera = session.cameras["b"]
    error = np.abs(session.picture(camera).astype(int) - session.field.render(camera).rgb)
    assert error.max() <= 1
    session.change(session.field.without([YELLOW]))
    picture, view = session.picture(camera), session.field.render(camera)
    assert np.abs(picture.astype(int) - view.rgb)[~view.unknown].max() <= 1


def test_changes_are_made_asked_again_taken_back_and_saved(folder, session, tmp_path):
    session.ask(["yellow"], Rules())
    assert session.answer.hits[0].objects[0][0] == YELLOW and not session.unsaved
    session.change(session.field.without([YELLOW]))
    assert YELLOW not in [id_ for id_, _ in session.answer.hits[0].objects]
    assert session.removed == {YELLOW} and session.unsaved
    session.change(session.field.teach("zorp", GREEN))
    session.change(session.field.named(GREEN, "the *zerp*"))
    assert session.ask(["zorp"], Rules()).hits[0].objects[0][0] == GREEN
    assert "taught" in told.answer(session)
    assert "the &#42;zerp&#42;" in told.answer(session)
    session.look = replace(session.look, selected=GREEN)
    assert "the &#42;zerp&#42;" in told.thing(session) and "zorp" in told.thing(session)
    (hit,) = session.ask(["The *Zerp*"], Rules()).hits
    assert [id_ for id_, _ in hit.objects] == [GREEN] and "named by you" in told.answer(session)
    assert session.undo() and session.field.names == {}
    assert "the *zerp*" in {text.lower() for text in session.answer.refused}
    copy = tmp_path / "copy"
    SemanticField.load(folder).save(copy)
    session.source = copy
    session.save()
    assert not session.unsaved
    again = Session(copy)
    assert again.removed == {YELLOW}
    assert again.ask(["zorp"], Rules()).hits[0].objects[0][0] == GREEN
    while session.undo():
        pass
    assert not session.removed and session.unsaved


def test_what_is_like_a_thing_is_told(session):
    session.look = replace(session.look, selected=RED)
    assert "like it" in told.alike(session)


def test_faint_gaussians_are_not_sent(folder, tmp_path):
    field = SemanticField.load(folder)
    faint = field.gaussians.opacities.clone()
    faint[::2] = 0.001
    field.changed(gaussians=replace(field.gaussians, opacities=faint)).save(tmp_path / "faint")
    session = Session(tmp_path / "faint")
    assert len(session.gaussians) == len(faint) // 2 == len(session.labels)
    with pytest.raises(InputError, match="nothing to look at"):
        none = field.changed(gaussians=replace(field.gaussians, opacities=0 * faint))
        none.save(tmp_path / "none")
        Session(tmp_path / "none")


def test_a_ply_can_be_looked_at_and_not_asked(folder, tmp_path):
    save_ply(SemanticField.load(folder).gaussians, tmp_path / "wall.ply")
    session = Session(tmp_path / "wall.ply")
    assert session.modes == ("colour", "depth") and session.cameras == {}
    picture = session.picture(session.stage.first)
    assert (picture.max(axis=2) > 100).mean() > 0.2  # it stands in view of where one begins
    assert session.click(session.stage.first, 10, 10) == 0
    for act in (lambda: session.ask(["red"], Rules()), session.save):
        with pytest.raises(InputError, match=r"wall\.ply: a \.ply knows no words"):
            act()


def test_a_damaged_field_is_refused(folder, tmp_path):
    copy = tmp_path / "copy"
    SemanticField.load(folder).save(copy)
    (copy / "bank.npz").write_bytes(b"no bank")
    with pytest.raises(SpecError, match="bank"):
        Session(copy)


def test_a_turn_is_a_film_that_moves(session):
    film = Image.open(io.BytesIO(shots.turn(session, session.cameras["a"])))
    frames = []
    for number in range(film.n_frames):
        film.seek(number)
        frames.append(np.asarray(film.convert("RGB")).astype(int))
    assert len(frames) == shots.FRAMES
    there, back = (np.abs(frames[0] - frames[k]).mean() for k in (shots.FRAMES // 2, -1))
    assert there > 2 and back < there / 3  # to the other side, and round again


@given(st.text(max_size=60))
def test_words_of_a_user_mean_nothing_to_markdown(text):
    """Letters, digits and entities alone: none of what Markdown or HTML would obey."""
    said = told.plain(text)
    assert not set(said) & set("<>*_`[]()!\\\"'\n|~")
    assert "javascript:" not in said
