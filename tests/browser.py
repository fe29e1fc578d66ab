"""Chromium without a window, for tests of pages: driven over its DevTools protocol.

It draws WebGL with software, a second or more a frame, so tests wait for a condition
(:meth:`Tab.wait`), never for a time. ``with Browser() as browser:`` starts one and leaves no
process behind; the fixture ``browser`` of ``tests/conftest.py`` is one a test session.
"""

from __future__ import annotations

import base64
import contextlib
import ctypes
import io
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 60.0
"""Seconds that a condition is waited for; a busy machine of two cores draws slowly."""

# Tests may run as root, which Chromium's sandbox refuses.
OPTIONS = (
    "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox",
    "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-quic", "--disable-extensions", "--disable-default-apps",
    "--no-first-run", "--no-default-browser-check", "--no-proxy-server", "--mute-audio",
    "--hide-scrollbars", "--remote-debugging-port=0",
)  # fmt: skip


def executable() -> str | None:
    """Return the path of a Chromium on this machine, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


def _end_with_parent() -> None:
    """Ask the kernel to end this process when its parent ends."""
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG


class PageError(Exception):
    """An exception in a script of the page, or a condition that did not become true in time."""


class Browser:
    """A Chromium with a new profile; as a context manager it is closed at the end.

    Raises:
        PageError: If it does not start; the message contains its output.
    """

    def __init__(self, *options: str) -> None:
        self._folder = tempfile.mkdtemp(prefix="slg-chromium-")
        stderr = Path(self._folder, "said")
        command = [executable(), *OPTIONS, *options, f"--user-data-dir={self._folder}/profile"]
        with stderr.open("wb") as output:
            # A session of its own, so that the whole group can be ended.
            self.process = subprocess.Popen(
                [*command, "about:blank"],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                preexec_fn=_end_with_parent,
                env={**os.environ, "HOME": self._folder},
            )
        file, end = Path(self._folder, "profile", "DevToolsActivePort"), time.monotonic() + PATIENCE
        lines: list[str] = []
        while len(lines) != 2 and time.monotonic() < end and self.process.poll() is None:
            time.sleep(0.02)
            lines = file.read_text().splitlines() if file.exists() else []
        if len(lines) != 2:
            problem = f"Chromium did not start: {stderr.read_text(errors='replace')[-2000:]}"
            self.close()
            raise PageError(problem)
        self.address = f"127.0.0.1:{lines[0]}{lines[1]}"

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def open(self, url: str, width: int = 1200, height: int = 800) -> Iterator[Tab]:
        """Open ``url`` in a new tab with a viewport in CSS pixels; close it at the end."""
        # No pings: while software draws, a busy machine answers none for longer than they wait.
        waits: dict[str, Any] = {"open_timeout": PATIENCE, "ping_interval": None}
        with connect(f"ws://{self.address}", max_size=None, proxy=None, **waits) as socket:
            tab = Tab(socket)
            try:
                tab.start(url, width, height)
                yield tab
            finally:
                with contextlib.suppress(Exception):
                    tab.send("Target.disposeBrowserContext", {"browserContextId": tab.context})

    def resident_bytes(self) -> int:
        """Return the memory of all processes; a page shared by k of them counts 1/k."""
        total = 0
        for folder in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ValueError):
                if os.getpgid(int(folder.name)) == self.process.pid:
                    rollup = Path(folder, "smaps_rollup").read_text()
                    total += 1024 * int(rollup.partition("\nPss:")[2].split()[0])
        return total

    def close(self) -> None:
        """End all processes and remove the profile."""
        for sign in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, sign)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(5)
        shutil.rmtree(self._folder, ignore_errors=True)


class Tab:
    """An open page.

    Attributes:
        requests: list of str. Every URL that it asked for, its own first; ``blob:`` and ``data:``
            too.
        complaints: list of str. Errors and warnings of the console, exceptions that nobody caught,
            and failed requests.
    """

    def __init__(self, socket: ClientConnection) -> None:
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._socket, self._numbers = socket, itertools.count(1)
        self._session = self.context = ""

    def start(self, url: str, width: int, height: int) -> None:
        """Open ``url`` in a new target, and watch it from before its first byte on."""
        self.context = self.send("Target.createBrowserContext", {})["browserContextId"]
        created = {"url": "about:blank", "browserContextId": self.context}
        target = self.send("Target.createTarget", created)["targetId"]
        attached = {"targetId": target, "flatten": True}
        self._session = self.send("Target.attachToTarget", attached)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        # In CSS pixels, which are the pixels of a screenshot.
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        answer = self.call("Page.navigate", url=url)
        if "errorText" in answer:
            raise PageError(f"{url}: {answer['errorText']}")
        self.wait("document.readyState === 'complete'")

    def send(self, method: str, values: dict[str, Any], session: str = "") -> dict[str, Any]:
        """Call a method of the protocol; record events that arrive before the answer."""
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": values}
        if session:
            message["sessionId"] = session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=4 * PATIENCE))
            if answer.get("id") == number:
                if "error" in answer:
                    raise PageError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            if session and answer.get("sessionId") == self._session:
                self._notice(answer["method"], answer["params"])

    def call(self, method: str, **values: Any) -> dict[str, Any]:
        """Call a method of the protocol for this page."""
        return self.send(method, values, self._session)

    def evaluate(self, script: str) -> Any:
        """Evaluate an expression in the page, awaiting promises; PageError if it throws."""
        answer = self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            message = details.get("exception", {}).get("description") or details["text"]
            raise PageError(f"{message} in: {script[:200]}")
        return answer["result"].get("value")

    def wait(self, condition: str, seconds: float = PATIENCE) -> Any:
        """Wait until an expression is true in the page, and return its value; else PageError."""
        end = time.monotonic() + seconds
        while not (value := self.evaluate(condition)):
            if time.monotonic() > end:
                raise PageError(f"not true in {seconds} s: {condition}; it said {self.complaints}")
            time.sleep(0.05)
        return value

    def settle(self, seconds: float = PATIENCE) -> np.ndarray:
        """Return the screenshot when two in a row are equal; PageError if they keep changing."""
        end, last = time.monotonic() + seconds, self.screenshot()
        while time.monotonic() < end:
            now = self.screenshot()
            if np.array_equal(now, last):
                return now
            last = now
        raise PageError(f"the picture still changes after {seconds} s")

    def screenshot(self) -> np.ndarray:
        """Return the page as an image, uint8 [H, W, 3]."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.array(Image.open(io.BytesIO(data)).convert("RGB"))

    def click(self, x: float, y: float) -> None:
        """Press and release the left button at (x, y) of the view, in CSS pixels."""
        self._mouse("mouseMoved", x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self._mouse(kind, x, y, button="left", clickCount=1)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 4) -> None:
        """Drag with the left button from a point of the view to another."""
        self._mouse("mouseMoved", *start)
        self._mouse("mousePressed", *start, button="left", clickCount=1)
        for k in range(1, steps + 1):
            x, y = (a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            self._mouse("mouseMoved", x, y, button="left", buttons=1)
        self._mouse("mouseReleased", *end, button="left", clickCount=1)

    def click_on(self, selector: str) -> None:
        """Click the middle of the first element that a CSS selector finds, scrolled into view."""
        box = self.evaluate(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "if (!e) return null; e.scrollIntoView({block: 'nearest'});"
            "const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        if box is None:
            raise PageError(f"no element {selector}")
        self.click(*box)

    def type(self, text: str) -> None:
        """Type text into the focused element."""
        self.call("Input.insertText", text=text)

    def press(self, key: str) -> None:
        """Press and release a key by its name, as ``Enter``, ``Escape``, ``ArrowLeft`` or ``w``."""
        codes = {"Enter": 13, "Escape": 27, "ArrowLeft": 37}
        values: dict[str, Any] = {"key": key, "code": f"Key{key.upper()}" if key.isalpha() else key}
        if key in codes:
            values |= {"code": key, "windowsVirtualKeyCode": codes[key]}
        text = {"Enter": "\r"}.get(key, key if len(key) == 1 else "")
        down: dict[str, Any] = {"type": "keyDown" if text else "rawKeyDown", **values}
        self.call("Input.dispatchKeyEvent", **down, **({"text": text} if text else {}))
        self.call("Input.dispatchKeyEvent", type="keyUp", **values)

    def _mouse(self, kind: str, x: float, y: float, **values: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **values)

    def _notice(self, method: str, values: dict[str, Any]) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(values["request"]["url"])
        elif method == "Network.loadingFailed" and not values.get("canceled"):
            self.complaints.append(f"failed request: {values.get('errorText')}")
        elif method == "Runtime.exceptionThrown":
            details = values["exceptionDetails"]
            message = details.get("exception", {}).get("description") or details["text"]
            self.complaints.append(f"exception: {message}")
        elif method == "Runtime.consoleAPICalled" and values["type"] in ("error", "warning"):
            message = " ".join(str(a.get("value", a.get("description"))) for a in values["args"])
            self.complaints.append(f"{values['type']}: {message}")
        elif method == "Log.entryAdded" and values["entry"]["level"] in ("error", "warning"):
            entry = values["entry"]
            self.complaints.append(f"{entry['level']}: {entry['text']} {entry.get('url', '')}")
