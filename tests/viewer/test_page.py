"""The one-file page, opened from disk in a real browser, against the field that it shows."""

import base64
import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from slgaussian import datasets
from slgaussian.benchmark.pictures import paint_relevancy
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.labels import LabelMaps
from slgaussian.language.rules import Rules
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera, Sample
from slgaussian.viewer.page.scene_page import scene_page
from tests.browser import Browser, Tab
from tests.known import known_field

H, W = 63, 84
MARKUP = """</script><img src=x onerror="alert(1)">' & "quoted" \u2028 <!--"""


@pytest.fixture(scope="module")
def field() -> SemanticField:
    """A procedural room with true depth and instances: one Gaussian for each pixel."""
    scene = datasets.load("procedural", seed=0, views=2, height=H, width=W)
    sample: Sample = scene.sample(list(scene.cameras))
    labels = np.stack([view.instances for view in sample.context]).astype(np.int32)
    points = np.concatenate([view.camera.unproject(view.depth) for view in sample.context])
    sizes = np.concatenate([0.6 * view.depth / view.camera.K[0, 0] for view in sample.context])
    colours = np.concatenate([view.image.reshape(-1, 3) for view in sample.context]) / 255
    n, rng = sizes.size, np.random.default_rng(0)
    quats = rng.normal(size=(n, 4))
    arrays = {
        "means": points.reshape(n, 3),
        "scales": sizes.reshape(n, 1) * rng.uniform(0.4, 1.4, (n, 3)),
        "quats": quats / np.linalg.norm(quats, axis=1)[:, None],
        "opacities": rng.uniform(0.6, 1, n),
        "sh": rgb_to_sh(torch.tensor(colours)).numpy(),
    }
    arrays = {name: values.astype(np.float32) for name, values in arrays.items()}
    guessed, source = rng.uniform(size=n) < 0.2, np.arange(n, dtype=np.int32)
    gaussians = Gaussians.from_arrays({**arrays, "guessed": guessed, "source": source})
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    method = Method(keep="all", settings={"lexicon": {"classifier": "none"}})
    return known_field(sample, gaussians, maps, method)


@pytest.fixture(scope="module")
def file(field, tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("page") / "scene.html"
    file.write_text(scene_page(field, texts=["dark red crate"]), "utf-8")
    return file


@pytest.fixture(scope="module")
def camera(field):
    return next(iter(field.cameras.values()))


@pytest.fixture(scope="module")
def view(field, camera):
    return field.render(camera)


@pytest.fixture(scope="module")
def page(browser, file):
    with open_page(browser, file) as tab:
        yield tab


@contextmanager
def open_page(browser: Browser, file: Path) -> Iterator[Tab]:
    """Open a page and wait for its first frame."""
    with browser.open(file.as_uri(), 700, 440) as tab:
        tab.wait("globalThis.slgaussian !== undefined", 120)
        yield tab


def snapshot(tab: Tab, view: int = 0) -> np.ndarray:
    """Return the page's rendering from the camera of a view."""
    url = tab.evaluate(f"slgaussian.snapshot({view})")
    return np.array(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB"))


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / max(((a.astype(float) - b) ** 2).mean(), 1e-9)))


def ask(tab: Tab, text: str) -> str:
    """Type a text as a user does, and return the answer."""
    tab.evaluate("slgaussian.clear()")
    enter(tab, text)
    return tab.wait("!slgaussian.busy && document.getElementById('answer').textContent")


def enter(tab: Tab, text: str) -> None:
    """Type a text into the search field and press Enter."""
    tab.click_on("#words")
    tab.type(text)
    tab.press("Enter")


def window_point(tab: Tab, camera: Camera, x: float, y: float) -> tuple[float, float]:
    """Return the window position of a camera's pixel while the page shows that camera."""
    eye = tab.evaluate("(({fx, cx, cy}) => ({fx, cx, cy}))(slgaussian.eye)")
    zoom = eye["fx"] / camera.K[0, 0]
    dx, dy = np.array([x, y]) + 0.5 - camera.K[:2, 2]
    return eye["cx"] + dx * zoom, eye["cy"] + dy * zoom


def selected_ids(tab: Tab) -> set[int]:
    things = "JSON.parse(document.getElementById('about').textContent).things"
    return set(tab.evaluate(f"slgaussian.asked[0].taken.map((k) => {things}[k].id)"))


def test_page_draws_as_the_rasteriser(page, field):
    page.evaluate("slgaussian.clear()")
    for index, camera in enumerate(field.cameras.values()):
        # 25 dB is required; the page has 8 bits for each colour, and 16 for a mean within a block.
        assert psnr(snapshot(page, index), field.render(camera).rgb) > 40
    assert psnr(snapshot(page, 0), field.render(camera).rgb) < 30  # a different view


def test_page_and_render_draw_a_splat_of_another_program_on_black(browser, field, camera, tmp_path):
    arrays = field.gaussians.to_arrays()
    thin = {"opacities": arrays["opacities"] * np.float32(0.3)}
    thin |= {"sh": arrays["sh"][:, :1], "source": np.full(len(field.gaussians), -1, np.int32)}
    foreign = field.with_changes(gaussians=field.gaussians.with_arrays(**thin))
    rendered = foreign.render(camera)
    drawn = rasterize(foreign.gaussians, None, camera).values.numpy().clip(0, 1) * 255
    assert (rendered.alpha < 0.9).mean() > 0.1
    assert psnr(rendered.rgb, drawn) > 45
    (tmp_path / "a.html").write_text(scene_page(foreign), "utf-8")
    with open_page(browser, tmp_path / "a.html") as tab:
        assert psnr(snapshot(tab), rendered.rgb) > 35


def test_answer_highlights_the_mask_of_the_query(page, view):
    ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], cv2.COLORMAP_INFERNO)[0, :, ::-1]
    for text in ("floor", "wall", "ball"):
        answer, hit = ask(page, text), view.query(text)
        assert f"score {hit.score:.3f}" in answer and hit.summary in answer
        picture = snapshot(page).astype(float)
        assert psnr(picture, paint_relevancy(hit.relevancy, view.rgb)) > 25
        heat = (picture - 0.34 * cv2.cvtColor(view.rgb, cv2.COLOR_RGB2GRAY)[..., None]) / 0.72
        distances = np.abs(heat[:, :, None] - ramp.astype(float)).sum(3)
        relevancy = distances.argmin(2) / 255
        rejected = [score for score in hit.scores if score < hit.objects[-1][1]]
        highlighted = relevancy > (hit.objects[-1][1] + max(rejected)) / 2
        assert (highlighted & hit.mask).sum() / (highlighted | hit.mask).sum() > 0.85
        assert selected_ids(page) == {id_ for id_, _ in hit.objects}


def test_stored_answers_equal_those_of_queries(page, field, view):
    """Stored answers hold for all views together, and so for a view that shows every object."""
    ids, verdicts = np.unique(view.ids[view.ids > 0]), set()
    assert ids.tolist() == [thing.id for thing in field.inventory()]
    answers = page.evaluate("[...slgaussian.words.answers.values()]")
    assert len(answers) > 1000
    for answer in answers[::29]:
        hit = view.query(answer["text"])
        assert ids[answer["taken"]].tolist() == [id_ for id_, _ in hit.objects]
        assert answer["scores"] == pytest.approx(hit.scores, abs=1e-6)
        assert answer["confidence"] == pytest.approx(hit.confidence, abs=1e-6)
        assert (answer["verdict"], answer["summary"]) == (hit.verdict, hit.summary)
        verdicts.add(hit.summary.split(":")[0])
    assert verdicts == {"found", "not sure", "probably not here"}
    for text, verdict in (("floor", "found"), ("cabinet", "not sure"), ("turquoise", "not here")):
        assert view.query(text).summary in ask(page, text)
        assert page.evaluate("slgaussian.asked[0].verdict") == verdict
        assert page.evaluate("slgaussian.look().dashes") == (verdict == "not sure")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("  The RED crate ", "red crate"),
        ("crates", "crate"),
        ("carpets, please", "carpet"),
        ("crate red", "red crate"),
        ("Dark  red crate", "dark red crate"),
        ("crimson unicorn", None),
        ("red green crate", None),
        ("", None),
    ],
)
def test_page_reads_texts_as_the_lexicon(page, field, text, expected):
    reading = page.evaluate(f"slgaussian.words.read({json.dumps(text)})")
    assert reading.get("text") == expected
    if expected:
        field.reader.understood(text)
        gaps = field.reader.gaps([text.split(",")[0], expected], Rules())
        np.testing.assert_allclose(gaps[0], gaps[1], atol=1e-12)
    else:
        assert reading["reason"]


def test_page_answers_taught_words_and_names(browser, field, view, tmp_path):
    (cone, _), *_ = view.query("cone").objects
    (ball, _), *_ = view.query("ball").objects
    taught = field.teach("Gizmo of mine", cone).rename(ball, "Anna's ball")
    (tmp_path / "a.html").write_text(scene_page(taught), "utf-8")
    with open_page(browser, tmp_path / "a.html") as tab:
        assert "(taught by example)" in ask(tab, "gizmo of MINE")
        assert selected_ids(tab) == {id_ for id_, _ in taught.find("gizmo of mine")}
        assert cone in selected_ids(tab)
        answer = ask(tab, "anna's  BALL")
        assert "(the name of an object)" in answer and selected_ids(tab) == {ball}
        assert "right" not in answer, "a name carries no probability of being right"


def test_page_reports_missing_webgl(browser, file):
    with Browser("--disable-3d-apis") as plain, plain.open(file.as_uri()) as tab:
        message = tab.wait(
            "!document.getElementById('waiting').textContent.startsWith('Unpacking')"
            " && document.getElementById('waiting').textContent"
        )
        assert message == "This browser has no WebGL 2, so it cannot draw the scene."
        assert tab.evaluate("document.getElementById('panel').hidden")


def test_several_texts_segment_the_scene(page, view):
    ask(page, "floor, wall")
    legend = page.evaluate("[...document.querySelectorAll('#legend li')].map(e => e.textContent)")
    hits = view.query_all(["floor", "wall"])
    assert legend == [f"{hit.text}{hit.verdict} {hit.confidence.mask:.2f}" for hit in hits]
    labels = view.segment(["floor", "wall"])
    picture = snapshot(page).astype(float)
    for label, hue in ((1, (242, 184, 75)), (2, (86, 180, 233))):
        colour = picture[labels == label].mean(0)
        assert colour @ hue > 0.985 * np.linalg.norm(colour) * np.linalg.norm(hue)
    page.evaluate("slgaussian.clear()")


def test_click_describes_the_object_under_it(page, field, camera, view):
    page.evaluate("slgaussian.clear()")
    page.click_on("#views button")
    page.wait("!slgaussian.busy")
    objects = {entry.id: entry for entry in field.inventory()}
    for text in ("floor", "wall", "cone"):  # away from holes, which are larger on the page
        x, y = view.query(text).point
        page.click(*window_point(page, camera, x, y))
        page.wait("!slgaussian.busy && !document.getElementById('card').hidden")
        card = page.evaluate("document.getElementById('card').textContent")
        entry = objects[int(view.ids[y, x])]
        assert f"Object {entry.id}" in card
        assert all(word in card for word, _ in entry.words)
        assert f"{entry.gaussians:,} Gaussians" in card
        pressed = "document.querySelector('#objects [aria-pressed=true]').textContent"
        assert page.evaluate(pressed).startswith(str(entry.id))


def test_keys_and_mouse_move_the_camera_and_ask(page):
    page.evaluate("slgaussian.clear(); slgaussian.goTo(0)")
    page.wait("!slgaussian.busy")
    before = page.evaluate("slgaussian.eye.centre.join()")
    for move in (
        lambda: page.drag((560, 200), (600, 220)),
        lambda: page.press("w"),
        lambda: page.press("ArrowLeft"),
    ):
        frame = page.evaluate("slgaussian.frame")
        axes = page.evaluate("[...slgaussian.eye.R, ...slgaussian.eye.centre].join()")
        page.evaluate("document.getElementById('picture').focus()")
        move()
        page.wait(f"slgaussian.frame > {frame} && !slgaussian.busy")
        assert page.evaluate("[...slgaussian.eye.R, ...slgaussian.eye.centre].join()") != axes
    page.press("0")
    page.wait(f"!slgaussian.busy && slgaussian.eye.centre.join() === {before!r}")
    page.press("/")
    assert page.evaluate("document.activeElement.id") == "words"
    page.type("floor")
    page.press("Enter")
    page.wait("slgaussian.asked.length === 1")
    page.press("Escape")
    page.wait("slgaussian.asked.length === 0 && document.getElementById('words').value === ''")


def test_page_makes_no_requests_and_logs_no_errors(page, file, field):
    assert page.requests[0] == file.as_uri()
    assert all(url.startswith("data:image/jpeg;base64,") for url in page.requests[1:])
    assert page.complaints == []
    policy = page.evaluate("document.querySelector('meta[http-equiv]').content")
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy
    assert scene_page(field, texts=["dark red crate"]) == file.read_text("utf-8")


def test_page_shows_names_as_text(browser, field, tmp_path):
    id_ = field.inventory()[0].id
    named = field.rename(id_, MARKUP.replace("\u2028", ""))
    (tmp_path / "a.html").write_text(
        scene_page(replace(named, settings={**named.settings, "scene": MARKUP})), "utf-8"
    )
    with open_page(browser, tmp_path / "a.html") as tab:
        assert tab.evaluate("document.title") == MARKUP
        assert tab.evaluate("document.querySelector('h1').textContent") == MARKUP
        listed = tab.evaluate("document.querySelector('#objects li').textContent")
        assert named.edits.names[id_] in listed
        assert tab.evaluate("document.querySelectorAll('img[src=x]').length") == 0
        assert tab.complaints == []


def test_page_omits_removed_objects(browser, field, camera, view, tmp_path):
    (ball, _), *_ = view.query("ball").objects
    edited = field.without([ball])
    (tmp_path / "a.html").write_text(scene_page(edited), "utf-8")
    with open_page(browser, tmp_path / "a.html") as tab:
        metadata = tab.evaluate("JSON.parse(document.getElementById('about').textContent)")
        assert ball not in [entry["id"] for entry in metadata["things"]]
        assert tab.evaluate("slgaussian.gaussians.n") == len(edited.visible) < len(field.gaussians)
        picture, rendered = snapshot(tab), edited.render(camera)
        assert psnr(picture, rendered.rgb) > 30
        assert rendered.unknown.any()
        stripes = np.isin(picture[rendered.unknown], (96, 160)).all(1)
        assert stripes.mean() > 0.9
