"""The whole method with given cameras and with found ones: what is lost without poses.

    python -m benches.cameras.road_without_poses DATA [--rows FILE] [--seeds 2]

DATA holds ``office`` and ``places``, labelled. Without poses, nothing but the two context
photographs is read, as ``slgaussian field a.jpg b.jpg`` reads them. A target's camera is brought
into the found world in two ways. "found": by the similarity that aligns the two context cameras; a
degree between given and found cameras then moves the whole picture, which costs much PSNR whatever
the field is like. "found, resected": as a third photograph would be, by its matches with points
that the two show. Its intrinsics are changed as those of the context are. Rows are kept in FILE as
they come, and what it holds is not done again.

The residual is the median distance of sharp matches from their epipolar lines, in pixels of the
size that fields are built at: the photographs' own say on whose cameras are better.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benches.cameras.pose_metrics import direction_error, rotation_error
from benches.common.machine import measured
from benches.common.markdown_tables import table
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import PLACES, SHEETS, built, labelled, read
from benches.scores.seed_spread import score
from flows.config import SceneSettings, Settings
from slgaussian.benchmark.annotations import read_truth
from slgaussian.cameras.check import agree
from slgaussian.cameras.matches import find_features, match
from slgaussian.cameras.relative import Relative
from slgaussian.cameras.subpixel import sharpen
from slgaussian.datasets import unposed
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.scene import Camera, Sample, View

GIVEN, FOUND, RESECTED = "given", "found", "found, resected"
DIGITS = {"iou": 3, "hit_mask": 2, "miou": 3, "psnr": 1, "residual": 2}

FEATURES, CONTRAST, RATIO = 4000, 0.02, 0.8
PIXELS = 1.0
"""Matches count for the residual if they lie within so many pixels of the fundamental matrix that
fits them best, whatever cameras it stands for."""


LEAST = 12
"""Points that a target is resected from; with fewer it stays where the similarity has it."""


def without_poses(scene: SceneSettings, given: Sample, resected: bool) -> Sample:
    """The sample with its cameras found from its context photographs, its targets brought along.

    Raises
    ------
    InputError
        If they cannot be found.
    """
    if scene.path is None:
        raise ValueError(f"{scene.name}: has no photographs on disk")
    size = given.context[0].image.shape[:2]
    found = unposed.photographs(*(scene.path / name for name in scene.context), size=size)
    place = similarity([view.camera for view in given.context], [v.camera for v in found.context])
    targets = [_moved(view, *place) for view in given.targets]
    pairs = list(zip(given.context, found.context, strict=True))
    longer = np.mean([there.camera.K[0, 0] / here.camera.K[0, 0] for here, there in pairs])
    shift = np.mean([there.camera.K[:2, 2] - here.camera.K[:2, 2] for here, there in pairs], 0)
    for i, view in enumerate(targets):
        K = view.camera.K * [[longer, longer, 1], [longer, longer, 1], [1, 1, 1]]
        K[:2, 2] += shift
        targets[i] = replace(view, camera=replace(view.camera, K=K))
    if resected:
        targets = [resect(view, *found.context[:2]) for view in targets]
    return replace(found, scene=given.scene, targets=tuple(targets))


def resect(target: View, a: View, b: View) -> View:
    """The view where its matches with points that ``a`` and ``b`` show say it was taken from."""
    features = [find_features(view.grey, FEATURES, CONTRAST) for view in (a, b, target)]
    i, j, _ = match(features[0], features[1], RATIO)
    k, at, _ = match(features[0], features[2], RATIO)
    _, shown, seen = np.intersect1d(i, k, return_indices=True)
    x, y, z = features[0].points[i[shown]], features[1].points[j[shown]], features[2].points
    there = Relative.between(a.camera, b.camera)
    inverse = there.triangulate(x, y)
    good = (np.abs(there.epipolar_distance(x, y)) < 2) & (inverse > 0)
    if good.sum() < LEAST:
        return target
    rays = np.c_[x, np.ones(len(x))][good] @ np.linalg.inv(a.camera.K).T / inverse[good, None]
    world = a.camera.center + rays @ a.camera.c2w[:3, :3].T
    w2c = target.camera.w2c
    solved, turn, t, inliers = cv2.solvePnPRansac(
        world,
        z[at[seen]][good],
        target.camera.K,
        None,
        cv2.Rodrigues(w2c[:3, :3])[0],
        w2c[:3, 3:].copy(),
        useExtrinsicGuess=True,
        reprojectionError=3.0,
        iterationsCount=1000,
    )
    if not solved or inliers is None or len(inliers) < LEAST:
        return target
    w2c[:3] = np.c_[cv2.Rodrigues(turn)[0], t]
    return replace(target, camera=replace(target.camera, c2w=np.linalg.inv(w2c)))


def similarity(
    given: Sequence[Camera], found: Sequence[Camera]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation [3, 3] and shift [3] that bring the first two given cameras to the found.

    The distance of the two gives the scale, the mean of their two turns the rotation, the point
    midway the shift.
    """
    turns = sum(
        there.c2w[:3, :3] @ here.c2w[:3, :3].T for here, there in zip(given, found, strict=True)
    )
    u, _, vt = np.linalg.svd(turns)
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    (a, b), (c, d) = ([camera.center for camera in pair[:2]] for pair in (given, found))
    scale = float(np.linalg.norm(d - c) / np.linalg.norm(b - a))
    return scale, R, (c + d) / 2 - scale * R @ ((a + b) / 2)


def _moved(view: View, scale: float, R: np.ndarray, shift: np.ndarray) -> View:
    c2w = np.eye(4)
    c2w[:3, :3] = R @ view.camera.c2w[:3, :3]
    c2w[:3, 3] = scale * R @ view.camera.center + shift
    depth = None if view.depth is None else view.depth * np.float32(scale)
    return replace(view, camera=replace(view.camera, c2w=c2w), depth=depth)


def residual(sample: Sample) -> float:
    """Median pixels by which the cameras miss sharp matches of the first two context views."""
    a, b = sample.context[:2]
    features = [find_features(view.grey, FEATURES, CONTRAST) for view in (a, b)]
    i, j, _ = match(*features, RATIO)
    at_a, at_b = features[0].points[i], sharpen((a.grey, b.grey), *features, i, j)
    kept = agree(at_a, at_b, PIXELS)
    distance = Relative.between(a.camera, b.camera).epipolar_distance(at_a[kept], at_b[kept])
    return float(np.median(np.abs(distance)))


def off(given: Sample, found: Sample) -> dict[str, float]:
    """How far found cameras are from given ones: degrees, and the focal length's error."""
    a, b = (Relative.between(*(view.camera for view in s.context[:2])) for s in (given, found))
    errors = [
        abs(there.camera.K[0, 0] / here.camera.K[0, 0] - 1)
        for here, there in zip(given.context, found.context, strict=True)
    ]
    return {
        "pose_error": max(rotation_error(b.R, a.R), direction_error(b.t, a.t)),
        "focal_error": float(np.mean(errors)),
    }


def measure(data: Path, file: Path, seeds: int) -> list[dict[str, Any]]:
    """A row a scene, seed and kind of cameras; where none were found, one that says so."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    there = {(row["scene"], row["seed"], row["cameras"]) for row in rows}
    with file.open("a") as out:
        for name in ("office", *(f"places/{place}" for place in PLACES)):
            for scene in labelled([name], data):
                for seed in range(seeds):
                    for kind in (GIVEN, FOUND, RESECTED):
                        if (scene.name, seed, kind) in there:
                            continue
                        row = {"place": name, "scene": scene.name, "seed": seed, "cameras": kind}
                        rows.append({**row, **scored(scene, seed, kind)})
                        out.write(json.dumps(rows[-1]) + "\n")
                        out.flush()
    return rows


def scored(scene: SceneSettings, seed: int, kind: str) -> dict[str, Any]:
    """The metrics of a scene with given or found cameras; why, if none were found."""
    given = read(scene, Settings())
    if scene.labels is None:
        raise ValueError(f"{scene.name}: has no labels")
    truth = read_truth(scene.labels, scene.categories, given.targets)

    def scores(sample: Sample) -> dict[str, float]:
        (inputs,) = built(sample, [seed])
        return score(inputs, scene, truth)

    if kind == GIVEN:
        return {"residual": residual(given), **scores(given)}
    try:
        found = without_poses(scene, given, resected=kind == RESECTED)
        own = {"residual": residual(found), **off(given, found)}
        return {**own, **scores(found)}
    except InputError as refusal:
        return {"refused": str(refusal)}


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row a scene, place, and for all: means of the scenes that both kinds of cameras built."""
    out = []
    scenes = list(dict.fromkeys((row["place"], row["scene"]) for row in rows))
    groups: dict[str, list[str]] = {scene: [scene] for _, scene in scenes}
    for place, scene in scenes:
        groups.setdefault(f"all of {place.split('/')[0]}", []).append(scene)
    for title, own in groups.items():
        answered = {
            row["scene"] for row in rows if row["cameras"] == FOUND and "refused" not in row
        }
        line: dict[str, Any] = {"scenes": title, "refused": len(set(own) - answered)}
        both = {
            kind: [
                row
                for row in rows
                if row["cameras"] == kind and row["scene"] in own and row["scene"] in answered
            ]
            for kind in (GIVEN, FOUND, RESECTED)
        }
        out.append(line)
        if not both[FOUND]:
            continue
        for key in DIGITS:
            values = [float(np.mean([row[key] for row in both[kind]])) for kind in both]
            line[key] = " → ".join(f"{value:.{DIGITS[key]}f}" for value in values)
            line[f"{key} change"] = values[-1] - values[0]
        for key in ("pose_error", "focal_error"):
            line[key] = float(np.median([row[key] for row in both[FOUND]]))
    return out


COLUMNS = {
    "scenes": ("scenes", str),
    "refused": ("refused", "d"),
    "iou": ("IoU", str),
    "hit_mask": ("point", str),
    "miou": ("mIoU", str),
    "psnr": ("PSNR", str),
    "residual": ("residual, px", str),
    "pose_error": ("pose off, °", ".1f"),
    "focal_error": ("focal off", ".0%"),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=data_folder(*SHEETS), help="folder of office and places")
    parser.add_argument("--rows", type=Path, default=Path("road.jsonl"), help="kept rows")
    parser.add_argument("--seeds", type=int, default=2)
    given = parser.parse_args()
    threads.limit(threads.cores())
    rows = measure(given.data, given.rows, given.seeds)
    lines = summary(rows)
    print(f"{measured()}\n")
    print(table(lines, COLUMNS))
    print(
        "\nGiven → found → found and resected; means over seeds and the scenes that were not "
        "refused."
    )
    better = [
        f"{line['scenes']} (PSNR {line['psnr change']:+.1f}, residual {line['residual']})"
        for line in lines
        if "psnr" in line
        and not line["scenes"].startswith("all of")
        and (line["psnr change"] > 0 or line["residual change"] < 0)
    ]
    print(f"Found cameras fit better: {'; '.join(better) or 'nowhere'}.")
    refused = {row["scene"]: row["refused"] for row in rows if "refused" in row}
    print("".join(f"Refused {scene}: {said}\n" for scene, said in refused.items()))


if __name__ == "__main__":
    main()
