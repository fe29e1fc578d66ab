"""Poses, focal intervals and confidence where EXIF is wrong, or the lens is distorted.

    python -m benches.cameras.lens_errors DATA [-o docs/measured] [--rows FILE]

The pairs are those of :mod:`benches.cameras.relative_pose`. EXIF gives the true focal length times
a factor; or there is no EXIF, and the photographs are distorted by Brown's k1, at their size, with
pixels outside of the photograph black. A pose is right up to :data:`RIGHT` degrees.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benches.cameras.pose_metrics import (
    WRONG,
    area_under_curve,
    direction_error,
    rotation_error,
)
from benches.cameras.posed_photographs import PosedPair, posed_pairs
from benches.common.harness import Format, parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.two_view import Photograph
from slgaussian.errors import InputError
from slgaussian.scene import View

VARIANTS: dict[str, tuple[float | None, float]] = {
    "no EXIF": (None, 0.0),
    **{f"EXIF times {factor:g}": (factor, 0.0) for factor in (1.0, 0.8, 1.25, 2.0)},
    **{f"k1 = {k1:g}, no EXIF": (None, k1) for k1 in (-0.4, -0.25, -0.1, 0.1)},
}
"""By name: factor of the focal length in EXIF, and distortion."""

RIGHT = 10.0
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


def distort(view: View, k1: float) -> np.ndarray:
    """Distort a photograph: its point at r focal lengths from the middle moves to r (1 + k1 r^2).

    The radius is found by bisection, independently of the estimation.
    """
    if not k1:
        return view.image
    focal, middle = (view.camera.K[0, 0] + view.camera.K[1, 1]) / 2, view.camera.K[:2, 2]
    height, width = view.image.shape[:2]
    pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1) - middle
    seen = np.linalg.norm(pixels, axis=-1) / focal
    fold = (-3 * k1) ** -0.5 if k1 < 0 else 10.0
    low, high = np.zeros_like(seen), np.full_like(seen, fold)
    for _ in range(50):
        radius = (low + high) / 2
        is_inside = radius * (1 + k1 * radius**2) < seen
        low, high = np.where(is_inside, radius, low), np.where(is_inside, high, radius)
    reached = seen < fold * (1 + k1 * fold**2)
    stretch = np.where(reached, low / np.maximum(seen, 1e-12), 1e6)
    columns, rows = np.moveaxis(pixels * stretch[..., None] + middle - 0.5, -1, 0)
    maps = columns.astype(np.float32), rows.astype(np.float32)
    return cv2.remap(view.image, *maps, cv2.INTER_LINEAR)


def measure(pairs: Iterable[PosedPair]) -> list[dict[str, Any]]:
    """Return a row per pair and variant; the error is infinite if the pair is refused."""
    rows = []
    for pair in pairs:
        views = (pair.a, pair.b)
        relative = pair.b.camera.w2c @ pair.a.camera.c2w
        true = [(view.camera.K[0, 0] + view.camera.K[1, 1]) / 2 for view in views]
        for variant, (factor, k1) in VARIANTS.items():
            photographs = [
                Photograph(
                    name, distort(view, k1), view.camera.width, view.camera.height,
                    "" if factor is None else "a lens",
                    None if factor is None else round(factor * focal, 1),
                )
                for name, view, focal in zip("ab", views, true, strict=True)
            ]  # fmt: skip
            row = {"variant": variant, "group": pair.group, "pair": pair.name, "error": np.inf}
            rows.append(row)
            try:
                estimate = find_cameras(photographs)
            except InputError:
                continue
            pose = estimate.cameras["b"].w2c @ estimate.cameras["a"].c2w
            focals = estimate.focals.values()
            inside = [f.low < t < f.high for f, t in zip(focals, true, strict=True)]
            row["error"] = max(
                rotation_error(pose[:3, :3], relative[:3, :3]),
                direction_error(pose[:3, 3], relative[:3, 3]),
            )
            row |= {"confidence": estimate.confidence, "warned": bool(estimate.warnings)}
            row |= {"inside": float(np.mean(inside))} if pair.focal_known else {}
    return rows


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row per variant."""
    out = []
    for variant in VARIANTS:
        of_variant = [row for row in rows if row["variant"] == variant]
        error = np.array([row["error"] for row in of_variant])
        answered = [row for row in of_variant if "confidence" in row]
        out.append(
            {
                "variant": variant,
                "auc": "/".join(f"{area:.1f}" for area in area_under_curve(error.tolist())),
                "refused": len(of_variant) - len(answered),
                "wrong": int(((error > WRONG) & np.isfinite(error)).sum()),
                "warned": sum(row["warned"] for row in answered),
                "inside": float(np.mean([row["inside"] for row in answered if "inside" in row])),
                "confidence": float(np.mean([row["confidence"] for row in answered])),
                "right": float(np.mean([row["error"] < RIGHT for row in answered])),
            }
        )
    return out


def confidences(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row per interval of confidence: its mean, and how many poses are right."""
    answered = [row for row in rows if "confidence" in row]
    out = []
    for low, high in pairwise(BINS):
        within = [row for row in answered if low < row["confidence"] <= high]
        if within:
            stated = float(np.mean([row["confidence"] for row in within]))
            right = float(np.mean([row["error"] < RIGHT for row in within]))
            bin_ = f"{low:g} to {high:g}"
            out.append({"bin": bin_, "pairs": len(within), "confidence": stated, "right": right})
    return out


COLUMNS: dict[str, tuple[str, Format]] = {
    "variant": ("122 pairs with", str),
    "auc": ("AUC 5/10/20°", str),
    "refused": ("refused", "d"),
    "wrong": ("wrong", "d"),
    "warned": ("warned", "d"),
    "inside": ("focal in its 90 % interval", ".0%"),
    "confidence": ("mean confidence", ".2f"),
    "right": ("right", ".2f"),
}
BIN_COLUMNS: dict[str, tuple[str, Format]] = {
    "bin": ("confidence", str),
    "pairs": ("pairs", "d"),
    "confidence": ("mean", ".2f"),
    "right": ("right", ".2f"),
}


def main() -> None:
    arguments = parser(__doc__, "poses.md")
    arguments.add_argument("data", type=data_folder("office/pairs.json"), help="folder of places")
    arguments.add_argument("--rows", type=Path, help="file for the rows")
    args = arguments.parse_args()
    cv2.setNumThreads(1)
    rows = measure(posed_pairs(args.data))
    if args.rows:
        args.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    tables = table(summary(rows), COLUMNS), table(confidences(rows), BIN_COLUMNS)
    publish(args.out, "poses.md", "python -m benches.cameras.lens_errors DATA", *tables)


if __name__ == "__main__":
    main()
