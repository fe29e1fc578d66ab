"""Through how many functions and files a photograph goes on its way to an answer.

``python benches/pipeline/road_hops.py [field | run] [--names]`` builds the field of a small
made-up room from photographs on disk, or runs a configuration of that one scene, in this process,
and looks at every call. A function of ours holds the picture when an argument or what it returns
does: an array or tensor of a number for each pixel or more, one of the objects that carry them, a
picture file's bytes, or its path. Lists, tuples and dicts are looked into.

Printed is how many functions held the picture, how many files these are in, and how often the trip
came back to a file that it had left, going through the functions by the time when each first held
it. Comprehensions and lambdas count as the function that they are written in. The same file counts
in any tree of the sources that stands first in ``PYTHONPATH``.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import tempfile
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
import torch
from PIL import Image

import slgaussian
from slgaussian import datasets

SIZE = (240, 320)
CARRIERS = {
    *("View", "Sample", "Scene", "Gaussians", "LabelMaps", "SceneGeometry", "SemanticField"),
}
MAGIC = (b"\x89PNG", b"\xff\xd8\xff")
DEPTH, MOST = 2, 16
"""How deep containers are looked into, and how many of their values."""
TREE = Path(slgaussian.__file__).resolve().parents[1]
OURS = tuple(f"{TREE / package}{os.sep}" for package in ("slgaussian", "flows", "tasks"))


class Trip:
    """The functions that held the picture, in the order in which each first did."""

    def __init__(self, photographs: set[str]) -> None:
        self.photographs = photographs
        self.held: dict[tuple[str, str], None] = {}
        self._ours: dict[CodeType, tuple[str, str] | None] = {}

    def watch(self, frame: FrameType, event: str, value: Any) -> None:
        """Look at a call or a return; for :func:`sys.setprofile`."""
        if event not in ("call", "return"):
            return
        code = frame.f_code
        function = self._function(code)
        if function is None or function in self.held:
            return
        if event == "call":
            count = code.co_argcount + code.co_kwonlyargcount
            count += bool(code.co_flags & 0x04) + bool(code.co_flags & 0x08)
            values = [frame.f_locals.get(name) for name in code.co_varnames[:count]]
        else:
            values = [value]
        if any(self._holds(value) for value in values):
            self.held[function] = None

    def _function(self, code: CodeType) -> tuple[str, str] | None:
        if code not in self._ours:
            file, name = code.co_filename, code.co_qualname
            while name.endswith(">") and ".<locals>.<" in name:
                name = name.rpartition(".<locals>.<")[0]
            ours = file.startswith(OURS) and not name.startswith("<")
            self._ours[code] = (file.removeprefix(f"{TREE}{os.sep}"), name) if ours else None
        return self._ours[code]

    def _holds(self, value: Any, depth: int = DEPTH) -> bool:
        if isinstance(value, np.ndarray):
            return value.size >= SIZE[0] * SIZE[1]
        if isinstance(value, torch.Tensor):
            return value.numel() >= SIZE[0] * SIZE[1]
        if isinstance(value, (str, Path)):
            return str(value) in self.photographs
        if isinstance(value, bytes):
            return value.startswith(MAGIC)
        if isinstance(value, dict):
            value = tuple(value.values())
        if isinstance(value, (list, tuple)):
            return depth > 0 and any(self._holds(part, depth - 1) for part in value[:MOST])
        return any(kind.__name__ in CARRIERS for kind in type(value).__mro__)

    def files(self) -> list[str]:
        """The files by turns: one after the other, never the same one twice running."""
        out: list[str] = []
        for file, _ in self.held:
            if not out or out[-1] != file:
                out.append(file)
        return out

    def returns(self) -> int:
        """How often the trip came back to a file that it had left."""
        files = self.files()
        return len(files) - len(set(files))


def write_room(folder: Path) -> list[Path]:
    """Three photographs of a made-up room and their cameras, as ``transforms.json``."""
    scene = datasets.load("procedural", seed=0, views=3, height=SIZE[0], width=SIZE[1])
    frames = []
    for name, camera in scene.cameras.items():
        Image.fromarray(scene.read(name).image).save(folder / f"{name}.png")
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        size = {"w": SIZE[1], "h": SIZE[0], "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
        pose = (camera.c2w * [1, -1, -1, 1]).tolist()
        frames.append({"file_path": f"{name}.png", "transform_matrix": pose, **size})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return [folder / f"{name}.png" for name in scene.cameras]


def command(which: str, folder: Path) -> tuple[list[str], set[str]]:
    """The words of the command line, and all that names a photograph of them."""
    first, between, second = write_room(folder)
    size = ["--size", "x".join(map(str, SIZE))]
    if which == "field":
        cameras = ["--cameras", str(folder / "transforms.json")]
        words = ["field", str(first), str(second), *cameras, "-o", str(folder / "field"), *size]
    else:
        config = folder / "room.toml"
        config.write_text(
            '[[scenes]]\nname = "room"\npath = "transforms.json"\n'
            f'context = ["{first.name}", "{second.name}"]\ntargets = ["{between.name}"]\n'
            'queries = ["floor"]\n'
        )
        words = ["run", str(config), "-o", str(folder / "out"), "--workers", "1", *size]
        words += ["--store", str(folder / "store"), "--runner", "threads"]
    names = {n for file in (first, between, second) for n in (str(file), file.name, file.stem)}
    return words, names


def count(which: str) -> Trip:
    """Run the command in this process, on all of its threads watched."""
    with tempfile.TemporaryDirectory() as made:
        words, names = command(which, Path(made).resolve())
        trip = Trip(names)
        entry = tomllib.loads((TREE / "pyproject.toml").read_text())["project"]["scripts"]
        module, _, function = entry["slgaussian"].partition(":")
        main = getattr(importlib.import_module(module), function)
        sys.argv = ["slgaussian", *words]
        with watched(trip):
            try:
                main()
            except SystemExit as end:
                if end.code:
                    raise
    return trip


class watched:
    def __init__(self, trip: Trip) -> None:
        self.trip = trip

    def __enter__(self) -> None:
        threading.setprofile(self.trip.watch)
        sys.setprofile(self.trip.watch)

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        threading.setprofile(None)


def lines(which: str, trip: Trip, names: bool) -> Iterator[str]:
    files = trip.files()
    yield f"{which}: {len(trip.held)} functions, {len(set(files))} files, {trip.returns()} returns"
    if names:
        yield from (f"  {file}: {name}" for file, name in trip.held)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", nargs="?", choices=("field", "run"), default="field")
    parser.add_argument("--names", action="store_true", help="print every function, in order")
    asked = parser.parse_args()
    print("\n".join(lines(asked.which, count(asked.which), asked.names)))


if __name__ == "__main__":
    main()
