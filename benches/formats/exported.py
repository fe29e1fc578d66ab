"""Size and error of every export format of a field.

    python -m benches.formats.exported DATA [-o docs/measured]

DATA is a folder of pairs of photographs, such as the office. The bench measures its first three
scenes and a procedural room. Chromium, which must be installed, draws the page (.html), and the
other files by programs of others, which ``npm ci`` in tests/formats/readers installs.
"""

import base64
import io
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import load_samples, photographs
from slgaussian.benchmark.metrics import psnr
from slgaussian.build import build_field
from slgaussian.cameras.paths import between
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.formats.low_pass import include_low_pass
from slgaussian.formats.splats import READERS, load_gaussians, save_gaussians
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera
from slgaussian.viewer.page.scene_page import scene_page
from tests.browser import Browser
from tests.formats.viewers import convert, serve_viewers

SCENES = 3

VIEWERS = {
    ".ply": ("spark", False),
    ".spz": ("spark", True),
    ".sog": ("spark", False),
    ".glb": ("playcanvas", True),
}
"""Viewer of a format, with its default settings, and if y is up in the file."""


def measure_formats(
    name: str, field: SemanticField, browser: Browser, folder: Path
) -> Iterator[dict]:
    """Yield a row per format: bytes, and the error of renderings after reloading it."""
    cameras = list(field.cameras.values())
    middle = between(cameras[0], cameras[-1], 0.5)
    written = include_low_pass(field.gaussians, cameras)
    true = [_draw(written, camera) for camera in (*cameras, middle)]
    common = {"scene": name, "gaussians": len(field.gaussians), "objects": len(field.bank)}
    for suffix, (viewer, y_up) in VIEWERS.items():
        file = folder / f"scene{suffix}"
        save_gaussians(field.gaussians, file, field.labels(), field.cameras)
        with (
            tempfile.TemporaryDirectory() as served,
            serve_viewers(browser, Path(served)) as viewers,
        ):
            (Path(served) / file.name).symlink_to(file)
            seen = viewers.draw(viewer, file.name, middle, y_up)
        drawn = psnr(seen, _draw(field.gaussians, middle))
        row = common | _row(suffix, file) | {"viewer": viewer, "drawn": drawn}
        if suffix == ".sog":
            file = convert(file, folder / "sog.ply")
        if file.suffix in READERS:
            reloaded, _ = load_gaussians(file)
            errors = [
                psnr(_draw(reloaded, camera), original)
                for camera, original in zip((*cameras, middle), true, strict=True)
            ]
            row |= {"context": min(errors[:-1]), "between": errors[-1]}
        yield row
    # The page gets the camera between the views only for this measurement.
    file = folder / "scene.html"
    file.write_text(scene_page(field), "utf-8")
    size = file.stat().st_size
    with_middle = field.with_changes(cameras={**field.cameras, "between": middle})
    file.write_text(scene_page(with_middle), "utf-8")
    with browser.open(file.as_uri(), 400, 300) as tab:
        tab.wait("globalThis.slgaussian !== undefined", 600)
        rendered = [
            _picture(tab.evaluate(f"slgaussian.snapshot({view})")) for view in range(len(true))
        ]
    errors = [
        psnr(picture, field.render(camera).rgb)
        for picture, camera in zip(rendered, with_middle.cameras.values(), strict=True)
    ]
    row = {"megabytes": size / 1e6, "context": min(errors[:-1]), "between": errors[-1]}
    yield common | _row(".html", file) | row


def _row(suffix: str, file: Path) -> dict:
    return {"format": suffix, "megabytes": file.stat().st_size / 1e6}


def _draw(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    picture = rasterize(gaussians, None, camera).values.numpy()
    return np.rint(picture.clip(0, 1) * 255).astype(np.uint8)


def _picture(url: str) -> np.ndarray:
    data = base64.b64decode(url.partition(",")[2])
    return np.array(Image.open(io.BytesIO(data)).convert("RGB"))


COLUMNS = {
    "scene": ("scene", str),
    "gaussians": ("Gaussians", ",d"),
    "objects": ("objects", "d"),
    "format": ("format", str),
    "megabytes": ("MB", ".2f"),
    "bytes": ("bytes a Gaussian", ".1f"),
    "context": ("PSNR at context, dB", ".1f"),
    "between": ("PSNR between, dB", ".1f"),
    "viewer": ("viewer", str),
    "drawn": ("PSNR in the viewer, dB", ".1f"),
}


def main() -> None:
    arguments = parser(__doc__, "exports.md")
    arguments.add_argument("data", type=photographs)
    args = arguments.parse_args()
    samples = dict(list(load_samples(args.data).items())[:SCENES]) | load_samples(None)
    rows = []
    with Browser() as browser, tempfile.TemporaryDirectory() as folder:
        for name, sample in samples.items():
            field = build_field(sample, Method())
            for row in measure_formats(name, field, browser, Path(folder)):
                rows.append(row | {"bytes": row["megabytes"] * 1e6 / row["gaussians"]})
                print(rows[-1], flush=True)
    publish(args.out, "exports.md", "python -m benches.formats.exported DATA", table(rows, COLUMNS))


if __name__ == "__main__":
    main()
