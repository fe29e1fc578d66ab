"""What the check of cameras says of true ones and of wrong ones: the tables of `docs/measured/`.

    python -m benches.predict.camera_check_rates DATA

DATA is a folder with ``office``, ``office_walk``, ``places`` and ``fern``, as far as they are
there; the motorcycle, the made-up rooms and the hard pairs ship with the code. Matches are found
once a pair, and judged under its own cameras and under each kind of wrong ones.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benches.common.machine import measured
from benches.predict import hard_pairs
from slgaussian import datasets
from slgaussian.cameras.check import BETTER, BOUND, PairCheck, check_pair
from slgaussian.cameras.matches import sift_matches
from slgaussian.scene import Camera, Scene, View

SEEDS = range(12)
BASELINES = (0.15, 0.6, 1.2, 2.0)
GAPS = (1, 2, 4)

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
        for gap in GAPS:
            for start in range(0, len(names) - gap, 6):
                yield f"walk, {gap} apart", _read(walk, names[start], names[start + gap])
    if (data / "fern").is_dir():
        fern = datasets.load("llff", data / "fern")
        names = list(fern.cameras)
        for a in range(0, len(names), 2):
            for b in range(a + 1, len(names), 4):
                yield "fern", _read(fern, names[a], names[b])
    yield "motorcycle", _read(datasets.load("stereo"), "left", "right")
    for baseline in BASELINES:
        for seed in SEEDS:
            room = datasets.load("procedural", seed=seed, views=2, baseline=baseline)
            yield f"rooms, {baseline:g} m", _read(room, *room.cameras)
    for name in hard_pairs.names():
        yield "hard pairs", hard_pairs.case(name).context[:2]


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
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.exit(__doc__)
    cv2.setNumThreads(1)
    true: dict[str, list[PairCheck]] = {}
    wrong: dict[str, dict[str, list[PairCheck]]] = {name: {} for name in WRONG}
    strangers: dict[str, list[PairCheck]] = {}
    seconds, before = [], {}
    for group, (a, b) in sets(Path(sys.argv[1])):
        start = time.process_time()
        true.setdefault(group, []).append(checked(a, b))
        seconds.append(time.process_time() - start)
        for name, change in WRONG.items():
            cameras = change(a.camera, b.camera)
            pair = (replace(v, camera=c) for v, c in zip((a, b), cameras, strict=True))
            wrong[name].setdefault(group, []).append(checked(*pair))
        # The second photograph with the pose of the pair before, as a wrong file name gives.
        if group in before:
            other = replace(b.camera, c2w=before[group].camera.c2w)
            strangers.setdefault(group, []).append(checked(a, replace(b, camera=other)))
        before[group] = b
    print(f"{measured()}\n")
    print(f"CPU seconds a pair: median {np.median(seconds):.2f}, most {max(seconds):.2f}\n")
    print("| pairs | judged | matches | explained of those that agree: least, median |", end="")
    print(" best correction over given: most | refused |\n|---|---|---|---|---|---|")
    for group, checks in true.items():
        judged = [check for check in checks if check.judged]
        shares = [check.coarse * check.matches / check.agreeing for check in judged] or [np.nan]
        gains = [check.gain for check in judged] or [np.nan]
        matches = int(np.median([check.matches for check in checks]))
        print(
            f"| {group} | {len(judged)} of {len(checks)} | {matches} | {min(shares):.2f}, "
            f"{np.median(shares):.2f} | {max(gains):.2f} | {sum(c.refuted for c in checks)} |"
        )
    print(
        f"\nRefused below {BOUND} of those that agree, or where a correction explains finely "
        f"{BETTER:g} times as many.\n"
    )
    print(f"| refused, with the cause named | {' | '.join(true)} |\n|---|{'---|' * len(true)}")
    for name, groups in {**wrong, "pose of another photograph": strangers}.items():
        print(f"| {name} | {' | '.join(_caught(groups.get(group, [])) for group in true)} |")


def _caught(checks: list[PairCheck]) -> str:
    judged = [check for check in checks if check.judged]
    if not judged:
        return ""
    refused = sum(check.refuted for check in judged) / len(judged)
    named = sum(check.correction is not None for check in judged) / len(judged)
    return f"{refused:.0%}, {named:.0%}"


if __name__ == "__main__":
    main()
