"""Helpers to run commands, and two photographs as their input."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from flows.cli import app
from slgaussian import datasets
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.language import load_encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.scene import Camera, Sample, Scene, View

ROOM = {
    "name": "room",
    "format": "procedural",
    "options": {"seed": 1, "objects": 4, "views": 3},
    "context": ["view_00", "view_02"],
    "targets": ["view_01"],
}
"""A made-up room as one of ``[[scenes]]``."""


def run(monkeypatch, *words) -> int:
    """Run ``slgaussian WORDS``; return the exit status."""
    monkeypatch.setattr(sys, "argv", ["slgaussian", *map(str, words)])
    with pytest.raises(SystemExit) as left:
        app.main()
    return left.value.code or 0


def settings(**values: object) -> list[str]:
    """Return ``--set KEY=VALUE`` for each setting."""
    return [word for key, value in values.items() for word in ("--set", f"{key}={value}")]


def score(settings, store, verbose: bool = False):
    """Run the flow of ``slgaussian run`` with settings and a store."""
    from flows.benchmark import score_scenes
    from flows.runners.environment import call_flow

    return call_flow(score_scenes, settings.model_copy(update={"store": store.root}), verbose)


def read_error(capsys) -> str:
    """Return the error message, one sentence, without the note that kernels are compiled."""
    lines = capsys.readouterr().err.splitlines(keepends=True)
    error = "".join(line for line in lines if not line.startswith("compiling kernels"))
    assert error.startswith("error: ") and error.count("\n") == 1
    return error


def room(height: int = 64, width: int = 64, seed: int = 1) -> Scene:
    """Return a small procedural room."""
    options = {**ROOM["options"], "seed": seed}
    return datasets.load("procedural", **options, height=height, width=width)


def room_sample() -> Sample:
    """Return a sample of the room's two context views, 64 x 64 pixels."""
    return room().sample(ROOM["context"], near=0.8, far=12.0)


def save_photographs(
    folder: Path, height: int = 64, width: int = 64, names=ROOM["context"], seed: int = 1
) -> Path:
    """Write views as files, with their cameras in ``transforms.json``."""
    scene = room(height, width, seed)
    return write_photographs(folder, {f"{name}.png": scene.read(name) for name in names})


def write_photographs(folder: Path, views: dict[str, View]) -> Path:
    """Write views as PNG files, with their cameras in ``transforms.json``; return the paths."""
    frames = []
    for name, view in views.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        alpha = [] if view.opaque is None else [np.where(view.opaque, 255, 0).astype(np.uint8)]
        Image.fromarray(np.dstack([view.image, *alpha])).save(folder / name)
        camera = view.camera
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        pose = (camera.c2w * [1, -1, -1, 1]).tolist()
        frame = {"file_path": name, "transform_matrix": pose, "w": camera.width}
        frames.append({**frame, "h": camera.height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder


def files_below(folder: Path, hidden: tuple[str, ...] = ()) -> dict[str, bytes]:
    """Read all files of a folder by path, except those whose paths begin with ``hidden``."""
    files = {str(p.relative_to(folder)): p for p in sorted(folder.rglob("*")) if p.is_file()}
    return {name: p.read_bytes() for name, p in files.items() if not name.startswith(hidden)}


def two_walls(folder: Path) -> Path:
    """Build a field of a red and a blue wall, each an object, seen from two cameras."""
    K = np.array([[40.0, 0, 24], [0, 40, 16], [0, 0, 1]])
    right = np.eye(4)
    right[0, 3] = 0.2
    cameras = {
        "images/001.png": Camera(K, np.eye(4), 48, 32),
        "images/002.png": Camera(K, right, 48, 32),
    }
    points = next(iter(cameras.values())).unproject(np.full((32, 48), 2.0)).reshape(-1, 3)
    is_red = (np.arange(32 * 48) % 48) < 24
    colour = np.where(is_red[:, None], (0.8, 0.05, 0.05), (0.05, 0.1, 0.8)).astype(np.float32)
    codes = np.array([[1, 0, 0], [0, 0, 1]], np.float32)
    n = len(points)
    features = np.concatenate([codes[np.where(is_red, 0, 1)], np.ones((n, 1))], 1)
    gaussians = {
        "means": points,
        "scales": np.full((n, 3), 0.04),
        "quats": np.tile([1.0, 0, 0, 0], (n, 1)),
        "opacities": np.full(n, 0.95),
        "sh": ((colour - 0.5) / 0.28209479177387814)[:, None],
        "features": features,
    }
    gaussians = {name: array.astype(np.float32) for name, array in gaussians.items()}
    gaussians = Gaussians.from_arrays({**gaussians, "source": np.arange(n, dtype=np.int32)})
    image = np.rint(colour.reshape(32, 48, 3) * 255).astype(np.uint8)
    masks = np.stack([is_red.reshape(32, 48), ~is_red.reshape(32, 48)])
    view = load_encoder("lexicon").encode_regions(image, masks)
    vectors = np.stack([view, view], 1).astype(np.float32)
    boxes = np.array([[[0, 0, 24, 32]] * 2, [[24, 0, 48, 32]] * 2], np.int32)
    ids, present = np.array([1, 2], np.int32), np.ones((2, 2), bool)
    bank = MemoryBank(ids, codes, vectors, present, boxes)
    SemanticField(gaussians, bank, cameras, {"encoder": "lexicon"}).save(folder)
    return folder


def transforms(folder, shift=0.0) -> Path:
    """Write a camera file without photographs: one frame, 96x64, moved right by ``shift``."""
    pose = np.diag([1.0, -1, -1, 1])  # OpenGL's axes
    pose[0, 3] = shift
    frame = {"file_path": "new/007.png", "transform_matrix": pose.tolist()}
    info = {"fl_x": 80, "cx": 48, "cy": 32, "w": 96, "h": 64, "frames": [frame]}
    (folder / "transforms.json").write_text(json.dumps(info))
    return folder / "transforms.json"
