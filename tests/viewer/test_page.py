"""The one-file page in a real browser, from disk: it draws, answers and names as the field does."""

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
from slgaussian.scene import Sample
from slgaussian.viewer.page.answers import compute_answers
from slgaussian.viewer.page.scene_page import scene_page
from tests.browser import Browser, Tab
from tests.known import known_field

H, W = 63, 84
NASTY = """</script><img src=x onerror="alert(1)">' & "quoted" \u2028 <!--"""


@pytest.fixture(scope="module")
def field() -> SemanticField:
    """A made-up room of which all is known: a Gaussian a pixel."""
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
    made = tmp_path_factory.mktemp("page") / "scene.html"
    made.write_text(scene_page(field, texts=["dark red crate"]), "utf-8")
    return made


@pytest.fixture(scope="module")
def page(browser, file):
    with shown(browser, file) as tab:
        yield tab


@contextmanager
def shown(browser: Browser, file: Path, width: int = 700, height: int = 440) -> Iterator[Tab]:
    """The page once it has drawn."""
    with browser.open(file.as_uri(), width, height) as tab:
        tab.wait("globalThis.slgaussian !== undefined", 120)
        yield tab


def snapshot(tab: Tab, view: int = 0) -> np.ndarray:
    """The picture at a view's camera, as the page draws it."""
    url = tab.evaluate(f"slgaussian.snapshot({view})")
    return np.array(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB"))


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / max(((a.astype(float) - b) ** 2).mean(), 1e-9)))


def ask(tab: Tab, text: str) -> str:
    """Type a text as a user does; what the page says."""
    tab.evaluate("slgaussian.clear()")
    tab.click_on("#words")
    tab.type(text)
    tab.press("Enter")
    return tab.wait("!slgaussian.busy && document.getElementById('answer').textContent")


def taken(tab: Tab) -> set[int]:
    return set(
        tab.evaluate(
            "slgaussian.asked[0].taken.flatMap((t, k) =>"
            "t ? [JSON.parse(document.getElementById('about').textContent).things[k].id] : [])"
        )
    )


def test_it_draws_what_the_rasteriser_draws(page, field):
    page.evaluate("slgaussian.clear()")
    for view, camera in enumerate(field.cameras.values()):
        # 25 dB is what a page must reach; it has 8 bits a colour, and 16 a mean within a block.
        assert psnr(snapshot(page, view), field.render(camera).rgb) > 40
    assert psnr(snapshot(page, 0), field.render(camera).rgb) < 30  # another view is another picture


def test_a_word_lights_up_the_pixels_that_a_query_takes(page, field):
    seen = field.render(field.cameras[next(iter(field.cameras))])
    ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], cv2.COLORMAP_INFERNO)[0, :, ::-1]
    for text in ("floor", "wall", "ball"):
        said = ask(page, text)
        hit = seen.query(text)
        assert f"score {hit.score:.3f}" in said and hit.summary in said
        picture = snapshot(page).astype(float)
        assert psnr(picture, paint_relevancy(hit.relevancy, seen.rgb)) > 25
        heat = (picture - 0.34 * cv2.cvtColor(seen.rgb, cv2.COLOR_RGB2GRAY)[..., None]) / 0.72
        apart = np.abs(heat[:, :, None] - ramp.astype(float)).sum(3)
        relevancy = apart.argmin(2) / 255
        others = [score for score in hit.scores if score < hit.objects[-1][1]]
        lit = relevancy > (hit.objects[-1][1] + max(others)) / 2
        assert (lit & hit.mask).sum() / (lit | hit.mask).sum() > 0.85
        assert taken(page) == {id_ for id_, _ in hit.objects}


def test_every_text_takes_what_a_query_takes(field):
    """In all views together, and so in one that shows every object."""
    ids = [thing.id for thing in field.inventory()]
    answers, _, selected = compute_answers(field, ids)
    assert answers["pairs"] and len(answers["texts"]) > 1000
    seen = field.render(next(iter(field.cameras.values())))
    assert set(ids) == set(np.unique(seen.ids)) - {0}, "every object is in view, so both are asked"
    for row in range(0, len(answers["texts"]), 37):
        chosen = {i for i, takes in zip(ids, selected[row], strict=True) if takes}
        assert chosen == {id_ for id_, _ in seen.query(answers["texts"][row]).objects}


def test_the_page_is_as_sure_as_a_query(page, field):
    seen = field.render(next(iter(field.cameras.values())))
    texts = page.evaluate("JSON.parse(document.getElementById('about').textContent).texts")[::29]
    asked = f"{json.dumps(texts)}.map((text) => slgaussian.words.ask(text))"
    verdicts = set()
    for text, answer in zip(texts, page.evaluate(asked), strict=True):
        hit, confidence = seen.query(text), answer["confidence"]
        assert confidence["mask"] == pytest.approx(hit.confidence.mask, abs=1e-5)
        assert confidence["point"] == pytest.approx(hit.confidence.point, abs=1e-5)
        assert (answer["verdict"], answer["summary"]) == (hit.verdict, hit.summary)
        verdicts.add(hit.summary.split(":")[0])
    assert verdicts == {"found", "not sure", "probably not here"}
    for text, verdict in (("floor", "found"), ("cabinet", "not sure"), ("turquoise", "not here")):
        assert seen.query(text).summary in ask(page, text)
        assert page.evaluate("slgaussian.asked[0].verdict") == verdict
        assert page.evaluate("slgaussian.look().dashes") == (verdict == "not sure")


@pytest.mark.parametrize(
    ("typed", "read"),
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
def test_texts_are_read_as_the_lexicon_reads_them(page, field, typed, read):
    found = page.evaluate(f"slgaussian.words.read({json.dumps(typed)})")
    assert found.get("text") == read
    if read:
        field.reader.understood(typed)
        a, b = field.reader.gaps([typed.split(",")[0], read], Rules())
        np.testing.assert_allclose(a, b, atol=1e-12)
    else:
        assert found["reason"]


def test_taught_words_and_names_are_answered(browser, field, tmp_path):
    camera = next(iter(field.cameras.values()))
    (cone, _), *_ = field.render(camera).query("cone").objects
    (ball, _), *_ = field.render(camera).query("ball").objects
    taught = field.teach("Gizmo of mine", cone).named(ball, "Anna's ball")
    (tmp_path / "a.html").write_text(scene_page(taught), "utf-8")
    with shown(browser, tmp_path / "a.html") as tab:
        assert "(taught by example)" in ask(tab, "gizmo of MINE")
        assert taken(tab) == {id_ for id_, _ in taught.find("gizmo of mine")}
        assert cone in taken(tab)
        said = ask(tab, "anna's  BALL")
        assert "(the name of an object)" in said and taken(tab) == {ball}
        assert "right" not in said, "of a name nothing is to be doubted"


def test_a_browser_that_cannot_draw_says_so(browser, file):
    with Browser("--disable-3d-apis") as plain, plain.open(file.as_uri()) as tab:
        said = tab.wait(
            "!document.getElementById('waiting').textContent.startsWith('Unpacking')"
            " && document.getElementById('waiting').textContent"
        )
        assert said == "This browser has no WebGL 2, so it cannot draw the scene."
        assert tab.evaluate("document.getElementById('panel').hidden")


def test_several_words_share_the_scene_out(page, field):
    ask(page, "floor, wall")
    legend = page.evaluate("[...document.querySelectorAll('#legend li')].map(e => e.textContent)")
    hits = field.render(next(iter(field.cameras.values()))).query_all(["floor", "wall"])
    for said, hit in zip(legend, hits, strict=True):
        assert said == f"{hit.text}{hit.verdict} {hit.confidence.mask:.2f}"
    camera = field.cameras[next(iter(field.cameras))]
    labels = field.render(camera).segment(["floor", "wall"])
    picture = snapshot(page).astype(float)
    for word, hue in ((1, (242, 184, 75)), (2, (86, 180, 233))):
        ours = picture[labels == word].mean(0)
        ours, wanted = ours / np.linalg.norm(ours), np.array(hue) / np.linalg.norm(hue)
        assert ours @ wanted > 0.985
    page.evaluate("slgaussian.clear()")


def test_a_click_names_what_is_under_it(page, field):
    page.evaluate("slgaussian.clear()")
    page.click_on("#views button")
    page.wait("!slgaussian.busy")
    seen = field.render(next(iter(field.cameras.values())))
    things = {thing.id: thing for thing in field.inventory()}
    for text in ("floor", "wall", "cone"):  # on no gap, which the page shows at more pixels
        x, y = seen.query(text).point
        eye = page.evaluate("(({fx, cx, cy}) => ({fx, cx, cy}))(slgaussian.eye)")
        K = next(iter(field.cameras.values())).K
        zoom = eye["fx"] / K[0, 0]
        page.click(eye["cx"] + (x + 0.5 - K[0, 2]) * zoom, eye["cy"] + (y + 0.5 - K[1, 2]) * zoom)
        page.wait("!slgaussian.busy && !document.getElementById('card').hidden")
        said = page.evaluate("document.getElementById('card').textContent")
        thing = things[int(seen.ids[y, x])]
        assert f"Object {thing.id}" in said
        assert all(word in said for word, _ in thing.words)
        assert f"{thing.gaussians:,} Gaussians" in said
        picked = "document.querySelector('#objects [aria-pressed=true]').textContent"
        assert page.evaluate(picked).startswith(str(thing.id))


def test_it_is_driven_by_keys_and_mouse(page):
    page.evaluate("slgaussian.clear(); slgaussian.goTo(0)")
    page.wait("!slgaussian.busy")
    before = page.evaluate("slgaussian.eye.centre.join()")
    for act in (
        lambda: page.drag((560, 200), (600, 220)),
        lambda: page.press("w"),
        lambda: page.press("ArrowLeft"),
    ):
        frame = page.evaluate("slgaussian.frame")
        axes = page.evaluate("[...slgaussian.eye.R, ...slgaussian.eye.centre].join()")
        page.evaluate("document.getElementById('picture').focus()")
        act()
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


def test_it_asks_the_network_for_nothing_and_complains_of_nothing(page, file, field):
    assert page.requests[0] == file.as_uri()
    assert all(url.startswith("data:image/jpeg;base64,") for url in page.requests[1:])
    assert page.complaints == []
    policy = page.evaluate("document.querySelector('meta[http-equiv]').content")
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe" not in policy
    assert scene_page(field, texts=["dark red crate"]) == file.read_text("utf-8")  # the same bytes


def test_names_are_text_and_never_markup(browser, field, tmp_path):
    id_ = field.inventory()[0].id
    named = field.named(id_, NASTY.replace("\u2028", ""))
    (tmp_path / "a.html").write_text(
        scene_page(replace(named, settings={**named.settings, "scene": NASTY})), "utf-8"
    )
    with shown(browser, tmp_path / "a.html") as tab:
        assert tab.evaluate("document.title") == NASTY
        assert tab.evaluate("document.querySelector('h1').textContent") == NASTY
        listed = tab.evaluate("document.querySelector('#objects li').textContent")
        assert named.names[id_] in listed
        assert tab.evaluate("document.querySelectorAll('img[src=x]').length") == 0
        assert tab.complaints == []


def test_what_was_removed_is_not_in_the_file(browser, field, tmp_path):
    camera = next(iter(field.cameras.values()))
    (gone, _), *_ = field.render(camera).query("ball").objects
    less = field.without([gone])
    (tmp_path / "a.html").write_text(scene_page(less), "utf-8")
    with shown(browser, tmp_path / "a.html") as tab:
        about = tab.evaluate("JSON.parse(document.getElementById('about').textContent)")
        assert gone not in [thing["id"] for thing in about["things"]]
        assert tab.evaluate("slgaussian.gaussians.n") == len(less.drawn) < len(field.gaussians)
        picture, drawn = snapshot(tab), less.render(camera)
        assert psnr(picture, drawn.rgb) > 30
        assert drawn.unknown.any()
        stripes = np.isin(picture[drawn.unknown], (96, 160)).all(1)
        assert stripes.mean() > 0.9
