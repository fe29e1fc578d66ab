"""Small procedural rooms as photographs on disk, for runs of many scenes of a second each."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image

from slgaussian import datasets

HEIGHT, WIDTH = 64, 80
QUERIES = ("red crate", "wall", "floor")


def write_rooms(folder: Path, count: int, views: int = 3) -> Path:
    """Write ``count`` rooms; return the file of `run`, for the first three views of each."""
    config = folder / "rooms.toml"
    if config.exists():
        return config
    entries = ["replicas = 1", "near = 0.8", "far = 12.0"]
    for seed in range(count):
        name = f"room_{seed:04d}"
        _write_room(folder / name, seed, views)
        entries += [
            "[[scenes]]",
            f'name = "{name}"',
            f'path = "{name}/transforms.json"',
            'context = ["view_00.png", "view_02.png"]',
            'targets = ["view_01.png"]',
            f"queries = {json.dumps(QUERIES)}",
        ]
    config.write_text("\n".join(entries) + "\n")
    return config


def _write_room(folder: Path, seed: int, views: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    scene = datasets.load("procedural", seed=seed, views=views, height=HEIGHT, width=WIDTH)
    frames = []
    for name, camera in scene.cameras.items():
        Image.fromarray(scene.read(name).image).save(folder / f"{name}.png")
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        pose = (camera.c2w * [1, -1, -1, 1]).tolist()
        size = {"w": WIDTH, "h": HEIGHT, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
        frames.append({"file_path": f"{name}.png", "transform_matrix": pose, **size})
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
