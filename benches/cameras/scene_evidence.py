"""Probability that estimated cameras are right, from the consistency of the views of a scene.

    python -m benches.cameras.scene_evidence DATA [-o docs/measured] [--rows FILE]

Cameras are estimated for the pairs of :mod:`benches.cameras.posed_photographs` and for pairs of
rendered rooms with difficulties: two focal lengths, roll, exposure, noise, JPEG and moving objects.
The depth of each pair gives the clash of its views (:mod:`slgaussian.cameras.quality`). A logistic
regression on clash and the confidence of the matches predicts whether the cameras are right (pose
error up to 20 degrees). It is compared, with ten-fold cross-validation, with that confidence alone.
FILE gets a row per pair, and pairs in it are not measured again.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import skimage.data
from scipy.optimize import minimize

from benches.cameras.pose_metrics import WRONG, direction_error, rotation_error
from benches.cameras.posed_photographs import posed_pairs
from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian.build import predict
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.quality import MAX_CONFIDENCE, MIN_CONFIDENCE
from slgaussian.cameras.two_view import Photograph
from slgaussian.components.method import Method
from slgaussian.datasets.procedural.rooms import FOCUS, furnish
from slgaussian.datasets.procedural.shading import photograph
from slgaussian.errors import InputError
from slgaussian.kernels.seeding import rng_for
from slgaussian.scene import Camera, Sample, View

ROOMS, WIDTH, HEIGHT = 96, 576, 416
OBJECTS, MOVED_SHARE = 10, 0.025
BINS = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)


def look_at(eye: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """Return the pose c2w [4, 4] of a camera at ``eye``, rolled by degrees."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    c2w = np.eye(4)
    c2w[:3, :3] = np.stack([c * right + s * down, c * down - s * right, forward], 1)
    c2w[:3, 3] = eye
    return c2w


def pinhole(focal: float, c2w: np.ndarray, scale: float = 1.0) -> Camera:
    """Return a camera with centred principal point and a focal length in image widths."""
    width, height = round(scale * WIDTH), round(scale * HEIGHT)
    K = np.array([[focal * width, 0, width / 2], [0, focal * width, height / 2], [0, 0, 1]])
    return Camera(K, c2w, width, height)


def hard_pair(seed: int) -> tuple[list[np.ndarray], list[Camera]]:
    """Render two photographs uint8 of a room, with random adverse conditions, and their cameras."""
    rng = rng_for(seed, "scene evidence", "pair")
    focal = float(np.exp(rng.uniform(np.log(0.5), np.log(2.5))))
    zoom = float(np.exp(rng.uniform(np.log(0.7), np.log(1.4)))) if rng.random() < 0.3 else 1.0
    eye = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-3.4, -2.4), rng.uniform(1.1, 1.7)])
    half = rng.uniform(0.12, 0.4)
    eyes = eye + np.array([[-half, 0, 0], [half, 0, 0]]) + rng.normal(0, 0.1, (2, 3))
    targets = FOCUS + rng.normal(0, 0.12, (2, 3))
    rolls = rng.normal(0, 2), rng.normal(0, 10)
    cameras = [
        pinhole(focal * factor, look_at(*view))
        for factor, view in zip((1.0, zoom), zip(eyes, targets, rolls, strict=True), strict=True)
    ]
    ends = [pinhole(0.9, look_at(FOCUS + [x, -3.3, 0.95], FOCUS, 0), 0.125) for x in (-0.3, 0.3)]
    room = furnish(rng_for(seed, "scene evidence", "room"), OBJECTS, ends)
    materials = room.materials(rng_for(seed, "scene evidence", "materials"))
    solids, casters = room.solids(), room.solids(casters=True)
    linear = [photograph(solids, casters, materials, room.light, camera) for camera in cameras]
    linear[1] = linear[1] * 2.0 ** -rng.uniform(0, 1.5)
    images = [np.clip(light, 0, 1) ** (1 / 2.2) for light in linear]
    for _ in range(round(float(rng.choice([0, 0.05, 0.1, 0.2])) / MOVED_SHARE)):
        add_object(images, rng)
    noise, quality = rng.uniform(0.005, 0.03), int(rng.integers(50, 96))
    photographs = []
    for image in images:
        noisy = np.uint8(255 * np.clip(image + rng.normal(0, noise, image.shape), 0, 1) + 0.5)
        _, jpeg = cv2.imencode(".jpg", noisy[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        photographs.append(np.ascontiguousarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[..., ::-1]))
    return photographs, cameras


def add_object(images: list[np.ndarray], rng: np.random.Generator) -> None:
    """Draw a round object into each image, at independent positions."""
    radius = round(np.sqrt(MOVED_SHARE * WIDTH * HEIGHT / np.pi))
    side = 2 * radius + 1
    photo = getattr(skimage.data, str(rng.choice(["coffee", "chelsea", "astronaut", "rocket"])))()
    photo = cv2.resize(photo[: min(photo.shape[:2]), : min(photo.shape[:2])], (side, side)) / 255
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disc = (x**2 + y**2 <= radius**2)[..., None]
    for image in images:
        row, column = rng.integers(0, HEIGHT - side + 1), rng.integers(0, WIDTH - side + 1)
        window = np.s_[row : row + side, column : column + side]
        image[window] = np.where(disc, photo, image[window])


Pair = tuple[list[np.ndarray], list[Camera]]
"""Two images and their true cameras."""


def pairs(data: Path) -> Iterator[tuple[str, str, Callable[[], Pair]]]:
    """Yield group, name, and a function that returns the pair."""
    for pair in posed_pairs(data):
        views = pair.a, pair.b
        images, cameras = [v.image for v in views], [v.camera for v in views]
        yield pair.group, pair.name, partial(tuple, (images, cameras))
    for seed in range(ROOMS):
        yield "hard rooms", str(seed), partial(hard_pair, seed)


def measure(images: Sequence[np.ndarray], cameras: Sequence[Camera]) -> dict[str, float] | None:
    """Estimate the cameras of a pair; return error, confidence and evidence, or None if refused."""
    photographs = [
        Photograph(name, image, camera.width, camera.height)
        for name, image, camera in zip("ab", images, cameras, strict=True)
    ]
    try:
        result = find_cameras(photographs)
        views = []
        for name, image in zip("ab", images, strict=True):
            camera = result.cameras[name]
            height, width = image.shape[:2]
            scale = min(1, WIDTH / max(height, width))
            w, h = round(scale * width), round(scale * height)
            small = cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA)
            K = np.diag([w / camera.width, h / camera.height, 1]) @ camera.K
            views.append(View(name, replace(camera, K=K, width=w, height=h), small))
        sample, method = Sample("pair", tuple(views)), Method()
        quality = predict(sample, method.predictor.load(), method.seed).quality
    except InputError:
        return None
    pose, true = (b.w2c @ a.c2w for a, b in (list(result.cameras.values()), cameras))
    error = max(
        rotation_error(pose[:3, :3], true[:3, :3]), direction_error(pose[:3, 3], true[:3, 3])
    )
    return {"error": error, "matches": result.confidence, "clash": quality.clash}


def fit(X: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Fit a logistic regression with a weak L2 penalty: intercept and weights, float64 [F + 1]."""

    def loss(w: np.ndarray) -> float:
        margins = (2 * right - 1) * (X @ w[1:] + w[0])
        return float(np.logaddexp(0, -margins).sum() + 0.01 * (w[1:] ** 2).sum())

    return minimize(loss, np.zeros(X.shape[1] + 1)).x


def cross_validate(X: np.ndarray, right: np.ndarray, parts: int = 10) -> np.ndarray:
    """Return the probability of each row, from a fit to the rows of the other folds."""
    part = np.random.default_rng(0).permutation(len(X)) % parts
    out = np.empty(len(X))
    for k in range(parts):
        w = fit(X[part != k], right[part != k])
        out[part == k] = 1 / (1 + np.exp(-(X[part == k] @ w[1:] + w[0])))
    return out


def reliability(name: str, probability: np.ndarray, right: np.ndarray) -> dict[str, Any]:
    """Return log loss, Brier score, and counts of right answers and answers per probability bin."""
    p = np.clip(probability, 1e-3, 1 - 1e-3)
    log_loss = -np.where(right, np.log(p), np.log(1 - p)).mean()
    row = {"name": name, "log_loss": log_loss, "brier": ((p - right) ** 2).mean()}
    for low, high in itertools.pairwise(BINS):
        inside = (probability >= low) & (probability < high + (high == 1))
        row[f"{low:g}"] = f"{right[inside].sum()} of {inside.sum()}"
    return row


def summary(rows: Sequence[Mapping[str, Any]]) -> tuple[list[dict[str, Any]], str]:
    """Return the rows of the table, and a sentence with counts and coefficients."""
    answered = [row for row in rows if "error" in row]
    right = np.array([row["error"] <= WRONG for row in answered])
    matches = np.array([row["matches"] for row in answered])
    clipped = matches.clip(MIN_CONFIDENCE, MAX_CONFIDENCE)
    X = np.stack([np.log(clipped / (1 - clipped)), [row["clash"] for row in answered]], 1)
    lines = [
        reliability("matches alone", matches, right),
        reliability("matches and clash", cross_validate(X, right), right),
    ]
    coefficients = ", ".join(f"{w:.2f}" for w in fit(X, right))
    hard = [row for row in answered if row["group"] == "hard rooms"]
    wrong = sum(row["error"] > WRONG for row in hard)
    return lines, (
        f"{len(rows)} pairs, {len(answered)} answered, {int((~right).sum())} of these wrong, of "
        f"which {wrong} of {len(hard)} hard rooms. Coefficients: {coefficients}."
    )


COLUMNS = {
    "name": ("probability by", str),
    "log_loss": ("log loss", ".3f"),
    "brier": ("Brier score", ".3f"),
    **{f"{low:g}": (f"right, {low:g} to {high:g}", str) for low, high in itertools.pairwise(BINS)},
}


def main() -> None:
    arguments = parser(__doc__, "poses.md")
    arguments.add_argument("data", type=data_folder("office"), help="photographs with cameras")
    arguments.add_argument("--rows", type=Path, default=Path("evidence.jsonl"), help="rows so far")
    args = arguments.parse_args()
    rows = (
        [json.loads(s) for s in args.rows.read_text().splitlines()] if args.rows.is_file() else []
    )
    measured = {(row["group"], row["name"]) for row in rows}
    with args.rows.open("a") as out:
        for group, name, load in pairs(args.data):
            if (group, name) not in measured:
                row = {"group": group, "name": name, **(measure(*load()) or {})}
                rows.append(row)
                out.write(json.dumps(row, default=float) + "\n")
                out.flush()
    lines, sentence = summary(rows)
    command = "python -m benches.cameras.scene_evidence DATA"
    publish(args.out, "poses.md", command, sentence, table(lines, COLUMNS))


if __name__ == "__main__":
    main()
