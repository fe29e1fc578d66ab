"""The viewer in a real browser, on a scene with an exact truth."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from slgaussian.errors import SLGaussianError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.language.query import NEAR_BEST
from slgaussian.rasterize import rasterize
from slgaussian.viewer import door as doors
from slgaussian.viewer import live, shots
from slgaussian.viewer.session import Session
from tests.browser import PATIENCE
from tests.flows.command import run
from tests.flows.command import said as command_said
from tests.flows.process_family import listening, stat_of
from tests.square import RED, YELLOW, square_field

viser = pytest.importorskip("viser", reason="needs viser: the extra `view`")

LONG = 3 * PATIENCE
"""Seconds that a condition is waited for: software draws slowly."""

WIDTH, HEIGHT = 900, 260
FREE = np.s_[:, :480]
"""The part of the window that the panel does not cover."""

NO_NOTICES = """document.head.insertAdjacentHTML("beforeend",
    '<style>[class*="Notification"] { display: none !important }</style>')"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("view") / "wall"
    saved(path)
    return path


def saved(path: Path) -> None:
    """The scene with Gaussians small and half transparent, as those of photographs mostly are.

    Few: with twice as many software draws twenty times as slowly.
    """
    field = square_field("separated", times=2)
    given = field.gaussians
    half = torch.full((len(given),), 0.5)
    field.changed(gaussians=replace(given, opacities=half, scales=0.7 * given.scales)).save(path)


@contextmanager
def shown(folder: Path, host: str = "127.0.0.1"):
    """A page of a field, while the block lasts."""
    session = Session(folder)
    page = live.Page(session, doors.listen(host, 0))
    try:
        yield page
    finally:
        page.stop()


@contextmanager
def looking(browser, page):
    """A tab that shows a page, once its scene is drawn, without the pictures of cameras."""
    with browser.open(page.door.address, WIDTH, HEIGHT) as tab:
        tab.wait("!!document.querySelector('canvas') && !!document.querySelector('input')")
        tab.evaluate(NO_NOTICES)  # viser says that software draws
        wait(lambda: page.clients)
        page._show_cameras(False)
        (client,) = page.clients
        # There the square is beside the panel.
        page._jump(SimpleNamespace(client=client), "b")
        there = page.session.cameras["b"].c2w
        wait(lambda: np.allclose(page._camera(client).c2w, there, atol=1e-3))
        wait(lambda: tab.screenshot()[FREE].std() > 20)
        yield tab


def wait(condition, seconds: float = LONG):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.05)
    return found


def own_picture(page) -> np.ndarray:
    """What our rasteriser draws of what the only client should see: float [H, W, 3]."""
    (client,) = page.clients
    return page.session.picture(page._camera(client)).astype(float)


def psnr(seen: np.ndarray, true: np.ndarray, where: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / ((seen - true)[where] ** 2).mean()))


def drawn(page) -> np.ndarray:
    """bool [H, W]: where the scene is opaque, in the part that nothing covers."""
    (client,) = page.clients
    where = np.zeros((HEIGHT, WIDTH), bool)
    where[FREE] = True
    gaussians, camera = page.session.gaussians, page._camera(client)
    return where & (rasterize(gaussians, None, camera).alpha.numpy() > 0.6)


def alike(tab, page, least: float = 25.0) -> np.ndarray:
    """Wait until the browser draws what our rasteriser does; the picture."""
    true, where = own_picture(page), drawn(page)
    assert where.sum() > 10_000
    seen = [tab.screenshot()]
    wait(lambda: psnr(seen.append(tab.screenshot()) or seen[-1], true, where) > least)
    return seen[-1].astype(float)


def press(tab, label: str) -> None:
    """Press a button of the panel."""
    tab.wait(f"[...document.querySelectorAll('button')].some({named(label)} && !e.disabled)")
    tab.evaluate(f"[...document.querySelectorAll('button')].find({named(label)}).click()")


def named(label: str) -> str:
    return f"e => e.textContent.trim() === {json.dumps(label)}"


def write(tab, label: str, text: str) -> None:
    """Type into the text box of this label, in place of what is there."""
    box = f"""[...document.querySelectorAll('label')].find({named(label)})"""
    script = (
        f"(() => {{ const l = {box}; const i = document.getElementById(l.htmlFor)"
        " || l.closest('div').parentElement.querySelector('input');"
        "i.scrollIntoView({block: 'nearest'}); i.focus(); i.select(); return !i.disabled; })()"
    )
    tab.wait(script)
    tab.type(text)


def control(label: str) -> str:
    """The input of a label of the panel, as an expression."""
    return (
        f"(() => {{ const l = [...document.querySelectorAll('label')].find({named(label)});"
        "return document.getElementById(l.htmlFor)"
        " || l.closest('div').parentElement.querySelector('input') })()"
    )


def unfold(tab, folder: str) -> None:
    """Open a folder of the panel."""
    tab.evaluate(f"[...document.querySelectorAll('div')].filter({named(folder)}).pop().click()")


def slide(tab, label: str, key: str) -> None:
    """Move the slider of this label by a key."""
    row = f"[...document.querySelectorAll('label')].find({named(label)}).closest('div')"
    tab.wait(
        f"(() => {{ const s = {row}.parentElement.querySelector('[role=slider]'); s.focus();"
        "return s.ariaDisabled !== 'true' && document.activeElement === s })()"
    )
    tab.press(key)


def choose(tab, label: str, option: str) -> None:
    """Choose an option of the list of this label."""
    tab.evaluate(f"{control(label)}.click()")
    options = "[...document.querySelectorAll('[role=option]')]"
    tab.wait(f"{options}.some({named(option)})")
    tab.evaluate(f"{options}.find({named(option)}).click()")


def ask_for(tab, page, words: str) -> None:
    """Ask for words; type again what viser's page did not send, as happens to text at once."""
    end, typed = time.monotonic() + LONG, words
    while page._words.value.strip() != words:
        assert time.monotonic() < end
        write(tab, "words", typed)
        typed += " "  # of the same text viser's page sends nothing
        with suppress(AssertionError):
            wait(lambda: page._words.value.strip() == words, 3)
    tab.press("Enter")


def said(tab) -> str:
    return tab.evaluate("document.body.innerText")


def test_ask_click_teach_remove_save_and_open_again(browser, folder, tmp_path):
    copy = tmp_path / "wall"
    SemanticField.load(folder).save(copy)
    with shown(copy) as page, looking(browser, page) as tab:
        before = alike(tab, page)

        ask_for(tab, page, "red")
        tab.wait("document.body.innerText.includes('score')", LONG)
        (hit,) = page.session.answer.hits
        assert [id_ for id_, _ in hit.objects] == [RED]
        assert f"object {RED}" in said(tab) and "known" in said(tab)
        lit = alike(tab, page)
        (client,) = page.clients
        ids = page.session.field.render(page._camera(client)).ids
        brighter, where = lit.sum(2) / np.maximum(before.sum(2), 1), drawn(page)
        others = where & (ids > 0) & (ids != RED)
        assert np.median(brighter[where & (ids == RED)]) > 1.1
        assert np.median(brighter[others]) < 0.9

        ask_for(tab, page, "")
        wait(lambda: page.session.look.mode == "colour")
        ys, xs = np.nonzero((ids == YELLOW)[FREE])
        middle = float(np.median(xs)), float(np.median(ys))
        tab.click(*middle)
        tab.wait(f"document.body.innerText.includes('Object {YELLOW}')", LONG)
        assert "yellow" in said(tab) and "Gaussians" in said(tab)
        write(tab, "word", "zorp")
        wait(lambda: page._word.value == "zorp")
        press(tab, "Teach: this is it")
        wait(lambda: "zorp" in page.session.field.taught)
        ask_for(tab, page, "zorp")
        tab.wait("document.body.innerText.includes('taught')", LONG)
        assert page.session.answer.hits[0].objects[0][0] == YELLOW

        press(tab, "Remove")
        wait(lambda: page.session.removed == {YELLOW})
        alike(tab, page)
        press(tab, "Undo")
        wait(lambda: not page.session.removed)
        tab.click(*middle)
        tab.wait(f"document.body.innerText.includes('Object {YELLOW}')", LONG)
        press(tab, "Remove")
        wait(lambda: page.session.removed == {YELLOW})
        press(tab, "Save")
        tab.wait("document.body.innerText.includes('Saved to')", LONG)
        assert not [c for c in tab.complaints if c.startswith("exception")]
        assert all(u.startswith((page.door.address, "blob:", "data:")) for u in tab.requests)

    with shown(copy) as page, looking(browser, page) as tab:
        assert page.session.removed == {YELLOW} and "zorp" in page.session.field.taught
        alike(tab, page)


def test_modes_marks_sliders_and_pictures_to_keep(browser, folder, tmp_path):
    with shown(folder) as page, looking(browser, page) as tab:
        tab.keep_downloads(tmp_path)
        choose(tab, "show", "objects")
        wait(lambda: page.session.look.mode == "objects")
        tab.evaluate(f"{control('what is unsure')}.click()")
        tab.wait("document.body.innerText.includes('unsure which object it is')", LONG)
        alike(tab, page)
        ask_for(tab, page, "red")
        tab.wait("document.body.innerText.includes('score')", LONG)
        (near,) = page.session.answer.hits
        unfold(tab, "How to take things")
        slide(tab, "how near", "ArrowLeft")
        wait(lambda: page.session.answer.rules.share == pytest.approx(NEAR_BEST - 0.05))
        tab.evaluate(f"{control('near the best')}.click()")
        wait(lambda: page.session.answer.rules.threshold == 0.5)
        slide(tab, "or above", "ArrowLeft")
        wait(lambda: page.session.answer.rules.threshold == pytest.approx(0.49))
        slide(tab, "temperature", "ArrowLeft")
        wait(lambda: page.session.answer.rules.temperature == pytest.approx(9.5))
        (hit,) = page.session.answer.hits
        assert hit.score < near.score
        tab.wait(f"document.body.innerText.includes('score {hit.score:.3f}')", LONG)
        (client,) = page.clients
        camera = page._camera(client)
        for label, name, draw in (
            ("Picture from here", "view.png", shots.picture),
            ("Short turn from here", "turn.gif", shots.turn),
        ):
            press(tab, label)
            wait(lambda name=name: (tmp_path / name).exists())
            assert (tmp_path / name).read_bytes() == draw(page.session, camera)
        assert not [c for c in tab.complaints if c.startswith("exception")]


def test_a_ply_of_anybody_is_looked_at(browser, folder, tmp_path):
    given = SemanticField.load(folder).gaussians
    save_ply(replace(given, scales=1.6 * given.scales), tmp_path / "strange.ply")
    with (
        shown(tmp_path / "strange.ply") as page,
        browser.open(page.door.address, WIDTH, HEIGHT) as tab,
    ):
        tab.wait("document.body.innerText.includes('A .ply holds no words')", LONG)
        tab.evaluate(NO_NOTICES)
        assert "Ask" not in said(tab) and "Click a thing" not in said(tab)
        wait(lambda: tab.screenshot()[FREE].std() > 20)
        choose(tab, "show", "depth")
        wait(lambda: page.session.look.mode == "depth")
        alike(tab, page)
        assert not [c for c in tab.complaints if c.startswith("exception")]


def test_the_address_needs_its_token_where_others_can_reach_it(browser, folder):
    with shown(folder, "0.0.0.0") as page:
        port, token = page.door.port, page.door.token
        for path in ("", "x/", "index.html", f"{token[:-1]}/"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=20)
            assert refused.value.code == 403
            with pytest.raises(InvalidStatus), connect(f"ws://127.0.0.1:{port}/{path}"):
                pass
        for path in ("../field.json", "%2e%2e/field.json", "field.json", "/etc/passwd"):
            with pytest.raises(urllib.error.HTTPError):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/{token}/{path}", timeout=20)
        with browser.open(f"http://127.0.0.1:{port}/{token}/", WIDTH, HEIGHT) as tab:
            tab.wait("document.body.innerText.includes('Click a thing')", LONG)


def joined(page, origin: str | None = None):
    """A client that is no browser."""
    protocol = f"viser-v{viser.__version__}"
    address = page.door.address.replace("http", "ws").rstrip("/")
    return connect(address, subprotocols=[protocol], origin=origin, max_size=None, proxy=None)


def test_other_sites_are_not_let_in(folder):
    with shown(folder) as page:
        with pytest.raises(InvalidStatus), joined(page, "http://evil.example"):
            pass
        with joined(page, page.door.address.rstrip("/")) as client:
            assert client.recv(timeout=20)


def test_ten_come_and_go_and_the_page_stays(folder):
    with shown(folder) as page:
        before = threading.active_count()
        sizes = []

        def one():
            with joined(page) as client:
                got = 0
                while got < 32 * len(page.session.gaussians):
                    got += len(client.recv(timeout=30))
                sizes.append(got)

        clients = [threading.Thread(target=one) for _ in range(10)]
        for client in clients:
            client.start()
        for client in clients:
            client.join(60)
        assert len(sizes) == 10
        cut = joined(page)
        cut.socket.close()  # without a word
        with joined(page) as client:
            assert client.recv(timeout=20)
        assert threading.active_count() < before + 20
    wait(lambda: threading.active_count() <= before)


def test_it_is_not_shared_through_a_server_elsewhere(folder):
    with shown(folder) as page:
        assert page._server.request_share_url() is None


def test_without_viser_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SLGaussianError, match=r"needs viser.* install it with `pip install "):
        live.load_viser()


def tcp_places(process: int) -> list[str]:
    """Where a process listens; none where it opens or closes something just now."""
    with suppress(FileNotFoundError):
        return [place for kind, place in listening(process) if kind == "tcp"]
    return []


def test_the_command_says_in_a_sentence_what_is_wrong(folder, tmp_path, monkeypatch, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert run(monkeypatch, "view", folder, "--port", port) == 2
        assert f"--port: {port} is in use" in command_said(capsys)
    assert run(monkeypatch, "view", tmp_path / "no.ply") == 2
    assert "no.ply" in command_said(capsys)
    assert run(monkeypatch, "view", tmp_path) == 2
    assert "field.json" in command_said(capsys)


@pytest.mark.whole
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_the_command_ends_when_it_is_told_to(folder, sign):
    command = [sys.executable, "-m", "slgaussian", "view", str(folder)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    address = child.stdout.readline().strip()
    assert urllib.request.urlopen(address, timeout=30).status == 200
    places = wait(lambda: tcp_places(child.pid))
    assert places and all(place.startswith("0100007F") for place in places)
    child.send_signal(sign)
    out, error = child.communicate(timeout=30)
    assert (child.returncode, out) == (0, "")
    assert error.splitlines() == ["Ctrl-C ends it", "", "stopped"]
    assert stat_of(child.pid) is None
