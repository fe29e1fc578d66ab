"""Nights of retraining on rough labels: promoted, refused, promoted again and rolled back.

    python -m benches.semantic.promotion FOLDER

The branch wins where labels are rough in the context views and precise in the target views, as
where annotators fill in a few views with a broad brush. Here a tracker of another package labels
procedural rooms by colour, and leaves out a band around every border in the context views. ``hard``
has no label there, and ``filled`` finds none in the other view. All rivals get the same lessons.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from slgaussian import datasets
from slgaussian.datasets import re10k

PACKAGE = '''
import cv2
import numpy as np

BAND = 17  # pixels between the labels of a rough map


class Rough:
    """Labels pixels by their colour, in context views with a band around every border."""

    final = repeatable = True

    def __init__(self):
        self.views = 0

    def add(self, frame, labels):
        """Do nothing: there is nothing to remember."""

    def propagate(self, frame):
        """Return the labels of the next view, the first two of which are the context."""
        self.views += 1
        smooth = cv2.medianBlur(frame.image, 7)
        lab = cv2.cvtColor(smooth, cv2.COLOR_RGB2LAB).astype(np.int32)
        ids = 1 + 9 * (lab[..., 0] // 86) + 3 * ((lab[..., 1] + 6) // 90) + (lab[..., 2] + 6) // 90
        if self.views > 2:
            return ids.astype(np.int32)
        kernel = np.ones((BAND, BAND), np.uint8)
        grey = ids.astype(np.uint8)
        inner = cv2.erode(grey, kernel) == cv2.dilate(grey, kernel)
        return np.where(inner, ids, 0).astype(np.int32)
'''

METADATA = "Metadata-Version: 2.1\nName: rough-labels\nVersion: 1\n"

ENTRY_POINT = "[slgaussian.trackers]\nrough = rough_labels:Rough\n"


def install(folder: Path) -> None:
    """Write the package, as pip would install it, to a folder of Python's path."""
    (folder / "rough_labels-1.dist-info").mkdir(parents=True, exist_ok=True)
    (folder / "rough_labels.py").write_text(PACKAGE)
    (folder / "rough_labels-1.dist-info" / "METADATA").write_text(METADATA)
    (folder / "rough_labels-1.dist-info" / "entry_points.txt").write_text(ENTRY_POINT)


def write_rooms(folder: Path, first: int, last: int) -> None:
    """Write small procedural rooms as chunks, unless they are there."""
    if not (folder / "index.json").exists():
        size = {"objects": 6, "views": 5, "baseline": 0.8, "height": 144, "width": 192}
        rooms = (datasets.load("procedural", seed=s, **size) for s in range(first, last + 1))
        re10k.write(folder, [re10k.encode_clip(room) for room in rooms])


def call(folder: Path, *words: str) -> None:
    """Run a command in the folder, and print it with what it prints."""
    path = os.pathsep.join([str(folder / "packages"), str(Path.cwd())])
    print("$ slgaussian", *words, flush=True)
    command = [sys.executable, "-c", "from flows.cli.app import main; main()", *words]
    subprocess.run(command, cwd=folder, env={**os.environ, "PYTHONPATH": path}, check=False)


def main(folder: Path) -> None:
    """Run three nights, and roll one back."""
    install(folder / "packages")
    write_rooms(folder / "first", 0, 29)
    write_rooms(folder / "second", 30, 35)
    fixed = ["--out", "corpus", "--models", "models", "--store", "store", "--set", "size=144x192"]
    fixed += ["--set", "tracker=rough", "--set", "most=1", "--set", "held_out=0.4"]
    first = ["--sources", "first"]
    both = [*first, "--sources", "second"]
    call(folder, "retrain", *first, *fixed, "--steps", "300")
    call(folder, "retrain", *both, *fixed, "--steps", "2")
    call(folder, "retrain", *both, *fixed, "--steps", "300")
    call(folder, "versions", "models", "--use", "1")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
