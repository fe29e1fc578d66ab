"""The command line as its users meet it, and two photographs to give it."""

import json
import sys
from pathlib import Path

import pytest
from PIL import Image

from flows import cli
from slgaussian import datasets
from slgaussian.scene import Sample, Scene

ROOM = {
    "name": "room",
    "format": "procedural",
    "options": {"seed": 1, "objects": 4, "views": 3},
    "context": ["view_00", "view_02"],
    "targets": ["view_01"],
}
"""A made-up room as one of ``[[scenes]]``."""


def run(monkeypatch, *words) -> int:
    """Exit status of ``slgaussian WORDS``."""
    monkeypatch.setattr(sys, "argv", ["slgaussian", *map(str, words)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    return left.value.code or 0


def said(capsys) -> str:
    """The one sentence of an error."""
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    return error


def room(height: int = 64, width: int = 64) -> Scene:
    """The room of :data:`ROOM`, small."""
    return datasets.load("procedural", **ROOM["options"], height=height, width=width)


def room_sample() -> Sample:
    """Its two context views, 64 x 64 pixels."""
    return room().sample(ROOM["context"], near=0.8, far=12.0)


def save_photographs(folder: Path, height: int = 64, width: int = 64) -> Path:
    """The context views as files, with their cameras in ``transforms.json``."""
    scene = room(height, width)
    frames = []
    for name in ROOM["context"]:
        camera = scene.cameras[name]
        Image.fromarray(scene.read(name).image).save(folder / f"{name}.png")
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        pose = (camera.c2w * [1, -1, -1, 1]).tolist()
        frame = {"file_path": f"{name}.png", "transform_matrix": pose, "w": width, "h": height}
        frames.append({**frame, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder
