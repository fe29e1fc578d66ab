"""What the viewer costs: seconds to the first picture and to light, bytes sent, frames, memory.

    python -m benches.viewer.view_cost WALK [-o docs/measured] [--pictures FOLDER]

WALK is a nerfstudio folder with frames of a walk in order, such as office_walk. -o writes
viewer.md; --pictures keeps what the browser showed of the first scene. Chromium draws with
software. Run it on a machine that does nothing else.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import viser
from PIL import Image
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.viewer.page_cost import SIZES
from slgaussian import datasets
from slgaussian.build import build_field
from slgaussian.parts.method import Method
from tests.browser import Browser, Tab

WINDOW = (960, 600)
SCENE = np.s_[60:, :600]
"""The part of the window that neither the panel nor a notice covers."""

PATIENCE = 300
QUIET = 3.0
COUNTED = 10
WORD = "floor"

FIND = "[...document.querySelectorAll('label')].find(e => e.textContent.trim() === 'words')"
FOCUS = f"""(() => {{ const l = {FIND}; const i = document.getElementById(l.htmlFor)
  || l.closest('div').parentElement.querySelector('input'); i.focus(); i.select(); }})()"""
FRAMES = f"""(async () => {{ let n = 0; const end = performance.now() + {COUNTED * 1000};
  while (performance.now() < end) {{ await new Promise(requestAnimationFrame); n++; }}
  return n; }})()"""
NO_NOTICES = """document.head.insertAdjacentHTML("beforeend",
    '<style>[class*="Notification"] { display: none !important }</style>')"""


class Listener:
    """A client that only counts what it is sent, and notes when that was."""

    def __init__(self, address: str) -> None:
        self.bytes, self.last = 0, time.perf_counter()
        self._socket = connect(
            address.replace("http", "ws").rstrip("/"),
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
            proxy=None,
        )
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        try:
            for message in self._socket:
                self.bytes, self.last = self.bytes + len(message), time.perf_counter()
        except ConnectionClosed:
            pass

    def settled(self) -> int:
        """How many bytes came, once nothing has come for a while."""
        while time.perf_counter() - self.last < QUIET:
            time.sleep(0.1)
        return self.bytes

    def close(self) -> None:
        self._socket.close()


def measured(name: str, count: int, folder: Path, pictures: Path | None) -> dict:
    start = time.perf_counter()
    command = [sys.executable, "-m", "slgaussian", "view", str(folder)]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        ready = time.perf_counter() - start
        with Browser() as browser, browser.open("about:blank", *WINDOW):
            bare = browser.resident_bytes()
            with browser.open(address, *WINDOW) as tab:
                tab.wait("!!document.querySelector('canvas')", PATIENCE)
                tab.evaluate(NO_NOTICES)
                until(lambda: tab.screenshot()[SCENE].std() > 20)
                shown = time.perf_counter() - start
                time.sleep(QUIET)
                listener = Listener(address)
                loaded = listener.settled()
                kept(pictures, "open", tab)
                frames = tab.evaluate(FRAMES) / COUNTED
                row = {
                    "name": name,
                    "gaussians": count,
                    "ready": ready,
                    "shown": shown,
                    "loaded": loaded / 1e6,
                    "frames": frames,
                    **asked(tab, listener),
                    "server": psutil.Process(server.pid).memory_info().rss / 2**20,
                    "page": (browser.resident_bytes() - bare) / 2**20,
                    "load": os.getloadavg()[0],
                }
                kept(pictures, "word", tab)
                listener.close()
                return row
    finally:
        server.terminate()
        server.wait(60)


def asked(tab: Tab, listener: Listener) -> dict:
    """What a word costs: seconds until it was sent and until it is seen, and bytes."""
    before, sent = tab.screenshot().astype(float), listener.bytes
    tab.evaluate(FOCUS)
    tab.type(WORD)
    start = time.perf_counter()
    tab.press("Enter")
    until(lambda: np.abs(tab.screenshot()[SCENE] - before[SCENE]).mean() > 8)
    seen = time.perf_counter() - start
    size = listener.settled() - sent
    return {"seen": seen, "sent": listener.last - start, "asked": size / 1e6}


def until(condition) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("error: the browser did not show what it should; is it overloaded?")


def kept(folder: Path | None, name: str, tab: Tab) -> None:
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        Image.fromarray(tab.screenshot()).save(folder / f"{name}.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=data_folder("transforms.json"))
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args()
    scene = datasets.load("nerfstudio", given.data)
    names = sorted(scene.cameras)
    rows: list[dict] = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (views, keep) in SIZES.items():
            field = build_field(scene.sample(names[: 2 * views : 2], [], "auto"), Method(keep=keep))
            field.save(Path(folder, "field"))
            pictures = None if rows else given.pictures
            rows.append(measured(name, len(field.gaussians), Path(folder, "field"), pictures))
            print(rows[-1], flush=True)
    file = None if given.out is None else given.out / "viewer.md"
    publish("viewer/viewer.md.j2", file, rows=rows, window=WINDOW, counted=COUNTED)


if __name__ == "__main__":
    main()
