"""A folder of data in every format, and what may happen to one between two runs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from posed_folders import FOCAL, HEIGHT, WIDTH, Shot, llff_row, picture, write_model

from slgaussian.datasets import re10k

NAMES = ("view_10.png", "view_2.png", "view_30.png", "view_4.png")
"""By name; by number the first comes third."""

ASKED = ("view_2", "view_4")

Change = Callable[["Folder"], object]


def save(file: Path, seed: int, width: int = WIDTH, height: int = HEIGHT, **options: Any) -> None:
    """Write a photograph, as PNG in as many bytes as any other of its size."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture(seed, width, height)).save(file, compress_level=0, **options)


@dataclass
class Folder:
    """Data of one scene.

    Attributes:
        path: What is given for it.
        images: Folder of the photographs.
        options: Of the format.
        asked: tuple of str. The views that are asked for: the second and the fourth.
        write: Writes the cameras with these x of the four photographs, in the order of these
            numbers.
        more: {what: change}. That may happen to this format only.
    """

    format: str
    path: Path
    images: Path
    options: Mapping[str, Any] = field(default_factory=dict)
    asked: tuple[str, ...] = ASKED
    write: Callable[[list[float], list[int]], object] | None = None
    more: Mapping[str, Change] = field(default_factory=dict)

    def photograph(self, number: int) -> Path:
        """The file of a photograph."""
        return self.images / NAMES[number]

    def changes(self) -> dict[str, Change]:
        """All that may happen to it, by what it is."""
        if self.format == "re10k":
            return dict(self.more)
        cameras: dict[str, Change] = {}
        if self.write is not None:
            write = self.write
            cameras = {
                "an asked camera is moved": lambda _: write([0, 0.15, 0.2, 0.3], [0, 1, 2, 3]),
                "cameras stand in another order": lambda _: write([0, 0.1, 0.2, 0.3], [3, 1, 0, 2]),
            }
        return CHANGES | cameras | dict(self.more)


def _edit_in_place(folder: Folder) -> None:
    file = folder.photograph(1)
    before = file.stat()
    save(file, 77)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert file.stat().st_size == before.st_size


CHANGES: dict[str, Change] = {
    "an asked photograph is edited, its size and time as before": _edit_in_place,
    "another is edited": lambda folder: save(folder.photograph(0), 78),
    "another is smaller": lambda folder: save(folder.photograph(0), 0, WIDTH // 2, HEIGHT // 2),
    "an asked one is cut short": lambda folder: os.truncate(folder.photograph(1), 999),
    "another is renamed and comes first": lambda folder: folder.photograph(2).rename(
        folder.images / "a.png"
    ),
    "an asked one is removed": lambda folder: folder.photograph(3).unlink(),
    "one is added": lambda folder: save(folder.images / "view_3.png", 50),
    "one is added beside with another ending": lambda folder: save(
        folder.photograph(1).with_suffix(".jpg"), 51
    ),
}


def write_folder(format: str, root: Path) -> Folder:
    """Write the data of a format below a folder."""
    return WRITERS[format](root)


def _photographs(folder: Path, names: tuple[str, ...] = NAMES) -> None:
    for number, name in enumerate(names):
        save(folder / name, number)


def _nerfstudio(root: Path) -> Folder:
    _photographs(root / "images")
    for number, name in enumerate(NAMES):
        depth = np.full((HEIGHT, WIDTH), 2.0 + number)
        np.save(root / Path(name).with_suffix(".npy"), depth)

    def write(xs: list[float], order: list[int], **keys: Any) -> None:
        frames = []
        for number in order:
            pose = np.eye(4)
            pose[0, 3] = xs[number]
            name = NAMES[number]
            frames.append(
                {
                    "file_path": f"images/{Path(name).stem}",
                    "transform_matrix": pose.tolist(),
                    "depth_file_path": Path(name).with_suffix(".npy").name,
                }
            )
        # Neither w nor h: they are those of the first photograph that is there.
        content = {"fl_x": FOCAL, "frames": frames, **keys}
        (root / "transforms.json").write_text(json.dumps(content))

    xs, order = [0, 0.1, 0.2, 0.3], [0, 1, 2, 3]
    write(xs, order)
    depth = root / "view_2.npy"
    more: dict[str, Change] = {
        "an asked depth is edited": lambda _: np.save(depth, np.ones((HEIGHT, WIDTH))),
        "a lens is stated": lambda _: write(xs, order, k1=0.1),
    }
    return Folder("nerfstudio", root, root / "images", write=write, more=more)


def _colmap(root: Path) -> Folder:
    _photographs(root / "images")

    def write(xs: list[float], order: list[int], text: bool = True) -> None:
        shots = {
            NAMES[number]: Shot(1 + place, place=(xs[number], 0, 0))
            for place, number in enumerate(order)
        }
        write_model(root / "sparse/0", shots, text=text)

    write([0, 0.1, 0.2, 0.3], [0, 1, 2, 3])
    more: dict[str, Change] = {
        "a binary model is added": lambda _: write([0, 0.2, 0.3, 0.4], [0, 1, 2, 3], text=False),
    }
    return Folder("colmap", root, root / "images", write=write, more=more)


def _llff(root: Path) -> Folder:
    _photographs(root / "images")

    def write(xs: list[float], order: list[int]) -> None:
        np.save(root / "poses_bounds.npy", [llff_row((xs[number], 0, 0)) for number in order])

    write([0, 0.1, 0.2, 0.3], [0, 1, 2, 3])
    return Folder("llff", root, root / "images", write=write)


def _llff_file(root: Path) -> Folder:
    folder = _llff(root)
    folder.path = root / "poses_bounds.npy"
    return folder


def _lerf_ovs(root: Path) -> Folder:
    inside = _colmap(root / "ramen")
    return Folder("lerf_ovs", root, inside.images, {"scene": "ramen"})


def _ovs3d(root: Path) -> Folder:
    inside = _llff(root / "bed")
    return Folder("ovs3d", root, inside.images, {"scene": "bed"})


def _photographs_alone(root: Path) -> Folder:
    _photographs(root / "images")
    return Folder("photographs", root, root / "images")


def _row(x: float) -> np.ndarray:
    row = np.zeros(18, np.float32)
    row[:4] = (0.8, 1.2, 0.5, 0.5)
    row[6:] = np.eye(4)[:3].ravel()
    row[9] = -x
    return row


def _re10k(root: Path) -> Folder:
    def clip(key: str, seed: int, step: float = 0.1) -> re10k.Clip:
        images = []
        for number in range(4):
            save(root / "frame.jpg", 10 * seed + number)
            images.append((root / "frame.jpg").read_bytes())
            (root / "frame.jpg").unlink()
        rows = np.stack([_row(step * number) for number in range(4)])
        return re10k.Clip(key, "https://example.org/x", np.arange(4), rows, tuple(images))

    def write(*clips: re10k.Clip) -> None:
        for file in root.iterdir():
            file.unlink()
        re10k.write(root, clips)

    root.mkdir(parents=True, exist_ok=True)
    one, two = clip("one", 1), clip("two", 2)
    write(one, two)
    more: dict[str, Change] = {
        "a photograph is edited": lambda _: write(clip("one", 3), two),
        "a camera is moved": lambda _: write(clip("one", 1, 0.2), two),
        "another clip is edited": lambda _: write(one, clip("two", 3)),
        "another clip is removed": lambda _: write(one),
        "the chunk is cut short": lambda _: os.truncate(root / "000000.torch", 2000),
    }
    return Folder("re10k", root, root, {"key": "one"}, asked=("1", "3"), more=more)


WRITERS: dict[str, Callable[[Path], Folder]] = {
    "nerfstudio": _nerfstudio,
    "colmap": _colmap,
    "llff": _llff,
    "llff file": _llff_file,
    "lerf_ovs": _lerf_ovs,
    "ovs3d": _ovs3d,
    "re10k": _re10k,
    "photographs": _photographs_alone,
}
