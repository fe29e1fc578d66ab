"""Viewers of others, in Chromium: they draw exported files from the camera of a test.

The packages are those of ``tests/formats/readers/package.json``; ``npm ci`` in that folder installs
them. Its page ``view.html`` has a function for each viewer.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
import subprocess
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from slgaussian.scene import Camera
from tests.browser import Browser

READERS = Path(__file__).parent / "readers"
TURN = np.diag([1.0, -1, -1, 1])
"""Between the axes of OpenCV and of OpenGL."""


def run_node(*words: object) -> str:
    """Run Node.js in the folder of packages, and return what it prints."""
    command = ["node", *map(str, words)]
    done = subprocess.run(command, cwd=READERS, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def convert(source: Path, target: Path) -> Path:
    """Convert a file of Gaussians by PlayCanvas's splat-transform, which keeps the axes."""
    tool = "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    run_node(tool, "-q", "-w", "-g", "cpu", source, target)
    return target


class Viewers:
    """The page of viewers, which finds the files of a folder."""

    def __init__(self, browser: Browser, address: str) -> None:
        self._browser, self._address = browser, address

    def call(self, script: str) -> Any:
        """Evaluate an expression that is a promise in a new tab with the page."""
        with self._browser.open(self._address) as tab:
            tab.wait("globalThis.draw !== undefined")
            tab.evaluate(
                f"{{ globalThis.done = null; ({script}).then(value => done = {{value}}, "
                "error => done = {error: String(error)}) }"
            )
            done = tab.wait("done", 240)  # a single message must not take as long
            assert "error" not in done, f"{done['error']}; the page said {tab.complaints}"
            return done["value"]

    def draw(self, viewer: str, name: str, camera: Camera, y_up: bool) -> np.ndarray:
        """Return the picture uint8 [H, W, 3] that a viewer draws of a file.

        Args:
            y_up: True if the file's axes are x right, y up, z backward.
        """
        pose = camera.c2w @ TURN
        view = {
            "width": camera.width,
            "height": camera.height,
            "pose": (TURN @ pose if y_up else pose).T.ravel().tolist(),
            "projection": _projection(camera).T.ravel().tolist(),
        }
        url = self.call(f"draw({json.dumps(viewer)}, {json.dumps(name)}, {json.dumps(view)})")
        data = base64.b64decode(url.partition(",")[2])
        return np.array(Image.open(io.BytesIO(data)).convert("RGB"))


@contextlib.contextmanager
def serve_viewers(browser: Browser, folder: Path) -> Iterator[Viewers]:
    """Serve the files of a folder with the page and its packages."""
    for name in ("view.html", "node_modules"):
        (folder / name).symlink_to(READERS / name)
    handler = partial(_Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield Viewers(browser, f"http://127.0.0.1:{server.server_port}/view.html")
        finally:
            server.shutdown()


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""


def _projection(camera: Camera, near: float = 0.01, far: float = 1000.0) -> np.ndarray:
    """Return the projection of OpenGL, float64 [4, 4]."""
    (fx, _, cx), (_, fy, cy) = camera.K[:2]
    width, height, depth = camera.width, camera.height, far - near
    return np.array(
        [
            [2 * fx / width, 0, 1 - 2 * cx / width, 0],
            [0, 2 * fy / height, 2 * cy / height - 1, 0],
            [0, 0, -(far + near) / depth, -2 * far * near / depth],
            [0, 0, -1, 0],
        ]
    )
