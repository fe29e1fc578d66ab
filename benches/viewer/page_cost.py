"""Cost of the page, as a file and live: bytes, seconds to open and to answer, memory.

    python -m benches.viewer.page_cost WALK [-o docs/measured]

WALK is a nerfstudio folder with frames of a walk in order, such as office_walk. Chromium renders in
software. Run it on an idle machine.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benches.common.harness import Format, parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian import datasets
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.viewer.page.scene_page import scene_page
from tests.browser import Browser, Tab

SIZES = {"two views, needed": (2, "needed"), "two views, all": (2, "all"), "eight, all": (8, "all")}
"""Number of views, and the setting ``keep`` of the method."""

FRAMES = 5
WINDOW = (960, 600)
PATIENCE = 900

RENDERER = """(() => { const gl = slgaussian.drawing.gl;
  const more = gl.getExtension("WEBGL_debug_renderer_info");
  return gl.getParameter(more ? more.UNMASKED_RENDERER_WEBGL : gl.RENDERER); })()"""


def measure(name: str, field: SemanticField, folder: Path) -> dict:
    start = time.perf_counter()
    html = scene_page(field)
    write_seconds = time.perf_counter() - start
    file = folder / "scene.html"
    file.write_text(html, "utf-8")
    with Browser() as browser, browser.open("about:blank", *WINDOW) as blank:
        bare = browser.resident_bytes()
        del blank
        with browser.open(file.as_uri(), *WINDOW) as tab:
            tab.wait("globalThis.slgaussian !== undefined", PATIENCE)
            marks = tab.evaluate(
                "Object.fromEntries(performance.getEntriesByType('mark')"
                ".map((mark) => [mark.name, mark.startTime / 1000]))"
            )
            frames = [_frame(tab) for _ in range(FRAMES)]
            lit = _time_answer(tab)
            used = browser.resident_bytes() - bare
            return {
                **_time_server(browser, field, folder / name),
                "name": name,
                "gaussians": len(field.gaussians),
                "made": write_seconds,
                "megabytes": len(html.encode()) / 1e6,
                "unpacked": marks["unpacked"],
                "shown": marks["shown"],
                "frame": statistics.median(frames),
                "light": lit,
                "memory": used / 2**20,
                "heap": tab.evaluate("performance.memory.usedJSHeapSize") / 2**20,
                "sort": tab.evaluate(
                    "(() => { const start = performance.now();"
                    "slgaussian.drawing.order.sort(slgaussian.eye, 0.01);"
                    "return performance.now() - start; })()"
                ),
                "load": os.getloadavg()[0],
                "renderer": tab.evaluate(RENDERER),
            }


def _time_server(browser: Browser, field: SemanticField, folder: Path) -> dict:
    """Measure seconds of `slgaussian view` to its address, the first picture and an answer."""
    field.save(folder)
    start = time.perf_counter()
    command = [sys.executable, "-c", "from flows.cli.app import main; main()", "view", str(folder)]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        ready = time.perf_counter() - start
        with browser.open(address, *WINDOW) as tab:
            tab.wait("globalThis.slgaussian !== undefined", PATIENCE)
            first_picture = tab.evaluate(
                "performance.getEntriesByName('shown')[0].startTime / 1000"
            )
            return {"address": ready, "served": first_picture, "served_light": _time_answer(tab)}
    finally:
        server.terminate()
        server.wait(60)


def _frame(tab: Tab) -> float:
    """Measure the seconds of a frame after a small rotation."""
    return tab.evaluate(
        "(async () => { slgaussian.viewpoint.turn(0.02, 0); await slgaussian.requestFrame();"
        "return slgaussian.frameMilliseconds / 1000; })()"
    )


def _time_answer(tab: Tab) -> float:
    """Measure the seconds from Enter to the frame with the answer."""
    tab.wait("!slgaussian.busy", PATIENCE)
    tab.click_on("#words")
    tab.type("floor")
    tab.evaluate(
        "asked = new Promise((done) => addEventListener('submit', async () => {"
        "const start = performance.now(), lit = () => slgaussian.asked.length && !slgaussian.busy;"
        "do await new Promise((go) => setTimeout(go, 2)); while (!lit());"
        "done((performance.now() - start) / 1000); },"
        "{capture: true, once: true})); 1"
    )
    tab.press("Enter")
    return tab.evaluate("asked")


COLUMNS: dict[str, tuple[str, Format]] = {
    "name": ("scene", str),
    "gaussians": ("Gaussians", ",d"),
    "megabytes": ("MB of the file", ".1f"),
    "made": ("seconds to write", ".1f"),
    "unpacked": ("unpacked, s", ".2f"),
    "shown": ("first picture, s", ".2f"),
    "frame": ("frame, s", ".2f"),
    "sort": ("sort, ms", ".0f"),
    "light": ("light, s", ".2f"),
    "address": ("address, s", ".2f"),
    "served": ("first picture, served, s", ".2f"),
    "served_light": ("light, served, s", ".2f"),
    "memory": ("memory, MiB", ",.0f"),
    "heap": ("heap, MiB", ",.0f"),
    "load": ("load", ".1f"),
}


def main() -> None:
    arguments = parser(__doc__, "exports.md")
    arguments.add_argument("data", type=data_folder("transforms.json"))
    args = arguments.parse_args()
    scene = datasets.load("nerfstudio", args.data)
    names = sorted(scene.cameras)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (views, keep) in SIZES.items():
            sample = scene.sample(names[: 2 * views : 2], [], "auto")
            rows.append(measure(name, build_field(sample, Method(keep=keep)), Path(folder)))
            print(rows[-1], flush=True)
    command = "python -m benches.viewer.page_cost WALK"
    renderer = f'The renderer calls itself "{rows[0]["renderer"]}".'
    publish(args.out, "exports.md", command, renderer, table(rows, COLUMNS))


if __name__ == "__main__":
    main()
