"""How many true cameras, and how many of each kind of wrong ones, the check of cameras refuses.

    python -m benches.cameras.camera_check_rates DATA [-o docs/measured]

DATA is a folder with ``office``, ``office_walk``, ``places`` and ``fern``, as far as they are
there; the made-up rooms ship with the code.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian import datasets
from slgaussian.cameras.check import PairCheck, check_pair
from slgaussian.cameras.matches import sift_matches
from slgaussian.scene import Camera, Scene, View

SEEDS = range(12)
BASELINE = 0.6

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
Pair = tuple[View, View]


def checked(a: View, b: View) -> PairCheck:
    """The check of two views by all of their matches."""
    return check_pair(a, b, *sift_matches(a.grey, b.grey))


def sets(data: Path) -> Iterator[tuple[str, Pair]]:
    """Every pair by the name of its set."""
    for place in ("office", *(f"places/{p.name}" for p in sorted(data.glob("places/*")))):
        if (data / place / "pairs.json").is_file():
            scene = datasets.load("nerfstudio", data / place)
            for pair in json.loads((data / place / "pairs.json").read_text()).values():
                yield place.split("/")[0], _read(scene, *pair["context"])
    if (data / "office_walk").is_dir():
        walk = datasets.load("nerfstudio", data / "office_walk")
        names = list(walk.cameras)
        for start in range(0, len(names) - 1, 6):
            yield "walk", _read(walk, names[start], names[start + 1])
    if (data / "fern").is_dir():
        fern = datasets.load("llff", data / "fern")
        names = list(fern.cameras)
        for a in range(0, len(names), 2):
            for b in range(a + 1, len(names), 4):
                yield "fern", _read(fern, names[a], names[b])
    for seed in SEEDS:
        room = datasets.load("procedural", seed=seed, views=2, baseline=BASELINE)
        yield "rooms", _read(room, *room.cameras)


def _read(scene: Scene, *names: str) -> Pair:
    views = [scene.read(scene.find(name)) for name in names]
    scale = min(1.0, (416 * 576 / views[0].image[..., 0].size) ** 0.5)
    height, width = (round(side * scale) for side in views[0].image.shape[:2])
    return tuple(view.resized(height, width) for view in views)


def _both(change: Callable[[Camera], Camera]) -> Callable[[Camera, Camera], tuple[Camera, Camera]]:
    return lambda a, b: (change(a), change(b))


def _focal(factor: float) -> Callable[[Camera, Camera], tuple[Camera, Camera]]:
    return _both(lambda c: replace(c, K=c.K * [[factor, factor, 1], [factor, factor, 1], [1] * 3]))


def _turned(degrees: float) -> Callable[[Camera, Camera], tuple[Camera, Camera]]:
    step = np.eye(4)
    step[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.ones(3) / 3**0.5)[0]
    return lambda a, b: (a, replace(b, c2w=b.c2w @ step))


def _shifted(share: float) -> Callable[[Camera, Camera], tuple[Camera, Camera]]:
    def change(camera: Camera) -> Camera:
        K = camera.K.copy()
        K[:2, 2] += share * np.array([camera.width, camera.height])
        return replace(camera, K=K)

    return _both(change)


WRONG = {
    "axes of OpenCV for OpenGL": _both(lambda c: replace(c, c2w=c.c2w @ FLIP)),
    "exchanged poses": lambda a, b: (replace(a, c2w=b.c2w), replace(b, c2w=a.c2w)),
    "world-to-camera, OpenGL": _both(lambda c: replace(c, c2w=FLIP @ np.linalg.inv(c.c2w) @ FLIP)),
    "world-to-camera, OpenCV": _both(lambda c: replace(c, c2w=np.linalg.inv(c.c2w) @ FLIP)),
    "focal length x 2": _focal(2),
    "focal length x 0.5": _focal(0.5),
    "focal length x 1.3": _focal(1.3),
    "focal length x 1.1": _focal(1.1),
    "intrinsics of twice the size": _both(lambda c: replace(c, K=np.diag([2, 2, 1.0]) @ c.K)),
    "principal point off by 0.1": _shifted(0.1),
    "principal point in the corner": _shifted(-0.5),
    "one pose off by 1 degree": _turned(1),
    "one pose off by 3 degrees": _turned(3),
    "one pose off by 10 degrees": _turned(10),
}


def main() -> None:
    arguments = parser(__doc__, "poses.md")
    arguments.add_argument("data", type=data_folder("office"))
    asked = arguments.parse_args()
    cv2.setNumThreads(1)
    checks: dict[str, dict[str, list[PairCheck]]] = {name: {} for name in ("true ones", *WRONG)}
    before: dict[str, View] = {}
    for group, (a, b) in sets(asked.data):
        checks["true ones"].setdefault(group, []).append(checked(a, b))
        for name, change in WRONG.items():
            cameras = change(a.camera, b.camera)
            pair = (replace(v, camera=c) for v, c in zip((a, b), cameras, strict=True))
            checks[name].setdefault(group, []).append(checked(*pair))
        if group in before:  # as a wrong file name gives it
            pose = replace(b.camera, c2w=before[group].camera.c2w)
            of_another = checks.setdefault("pose of another photograph", {})
            of_another.setdefault(group, []).append(checked(a, replace(b, camera=pose)))
        before[group] = b
    rows = []
    for name, groups in checks.items():
        judged = {group: [c for c in some if c.judged] for group, some in groups.items()}
        shares = {g: sum(c.refuted for c in some) / len(some) for g, some in judged.items() if some}
        rows.append({"cameras": name, **shares})
    columns = {"cameras": ("refused of those judged", str)}
    columns |= {group: (group, ".0%") for group in checks["true ones"]}
    command = "python -m benches.cameras.camera_check_rates DATA"
    publish(asked.out, "poses.md", command, table(rows, columns))


if __name__ == "__main__":
    main()
