"""The driver of Chromium that the tests of pages stand on."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.browser import Browser, PageError, executable

PAGE = """<!doctype html><meta charset="utf-8"><title>a page</title>
<style>body { margin: 0; background: rgb(10, 200, 30) } #b { width: 200px; height: 100px }</style>
<button id="b" onclick="this.textContent = 'pressed'">press</button><input id="t">
<canvas id="c" width="64" height="64"></canvas>
<script>
document.querySelector("#t").onkeydown = (e) => { if (e.key === "Enter") entered = e.target.value };
const gl = document.querySelector("#c").getContext("webgl2");
</script>"""


@pytest.fixture
def page(tmp_path: Path) -> str:
    (tmp_path / "page.html").write_text(PAGE)
    return (tmp_path / "page.html").as_uri()


def test_a_page_is_clicked_typed_into_and_looked_at(browser, page):
    with browser.open(page, 300, 200) as tab:
        assert tab.evaluate("document.title") == "a page"
        picture = tab.screenshot()
        assert picture.shape == (200, 300, 3)
        assert (picture[-1, -1] == (10, 200, 30)).all()
        tab.click(100, 50)
        tab.wait("document.querySelector('#b').textContent === 'pressed'")
        tab.click_on("#t")
        tab.type("two words")
        tab.press("Enter")
        assert tab.wait("entered") == "two words"
        assert tab.evaluate("Promise.resolve(6 * 7)") == 42
        assert tab.requests == [page]
        assert tab.complaints == []


def test_webgl2_draws(browser, page):
    with browser.open(page, 300, 200) as tab:
        tab.evaluate("gl.clearColor(1, 0, 0, 1); gl.clear(gl.COLOR_BUFFER_BIT)")
        picture = tab.settle()
        assert np.count_nonzero((picture == (255, 0, 0)).all(2)) == 64 * 64


def test_requests_and_complaints_are_noticed(browser, page, tmp_path):
    with browser.open(page) as tab:
        missing = (tmp_path / "nothing.js").as_uri()
        tab.evaluate(f"new Promise(r => {{ i = new Image(); i.onerror = r; i.src = '{missing}' }})")
        tab.evaluate("console.error('one thing'); setTimeout(() => { throw Error('two') }); 1")
        tab.evaluate("new Promise(r => setTimeout(r, 10))")
        assert tab.requests == [page, missing]
        assert any("one thing" in said for said in tab.complaints)
        assert any("two" in said for said in tab.complaints)
        with pytest.raises(PageError, match="three"):
            tab.evaluate("(() => { throw Error('three') })()")
        with pytest.raises(PageError, match="not true in"):
            tab.wait("false", seconds=0.1)


@pytest.mark.skipif(executable() is None, reason="no Chromium on this machine")
def test_nothing_is_left_of_a_browser(page):
    def left() -> list[str]:
        found = []
        for folder in Path("/proc").iterdir():
            try:
                said = (folder / "cmdline").read_bytes()  # empty: it ended, nobody asked how
                own = said and os.getpgid(int(folder.name)) == browser.process.pid
                named = browser._folder.encode() in said
            except (OSError, ValueError):
                continue
            if own or named:
                found.append(folder.name)
        return found

    with Browser() as browser, browser.open(page) as tab:
        assert tab.evaluate("1") == 1
        assert browser.resident_bytes() > 2**20
        assert len(left()) > 2
    end = time.monotonic() + 20
    while left() and time.monotonic() < end:
        time.sleep(0.05)
    assert left() == []
    assert not os.path.exists(browser._folder)


@pytest.mark.skipif(executable() is None, reason="no Chromium on this machine")
def test_a_browser_ends_with_tests_that_are_killed():
    code = (
        "import time; from tests.browser import Browser; b = Browser();"
        "print(b.process.pid, b._folder, flush=True); time.sleep(600)"
    )
    owner = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pid, folder = owner.stdout.readline().split()
    owner.kill()
    owner.wait()
    end = time.monotonic() + 20

    def lives() -> bool:
        try:
            return folder.encode() in Path("/proc", pid, "cmdline").read_bytes()
        except OSError:
            return False

    while lives() and time.monotonic() < end:
        time.sleep(0.05)
    assert not lives()
    shutil.rmtree(folder, ignore_errors=True)
