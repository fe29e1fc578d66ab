"""Cameras of chains of three to eight photographs, by our method and COLMAP's incremental mapper.

    python -m benches.cameras.chains DATA [-o docs/measured] [--rows FILE]

:mod:`benches.cameras.posed_photographs` reads DATA. Both methods get only the photographs, and the
information that they share one lens. The error of a pair of views is the larger of the angular
errors of rotation and direction of translation; pairs with a view that was not registered count as
wrong. pycolmap runs if it is installed, with two-view tracks, and initial pairs
from 4 degrees and 30 inliers. FILE gets a row per chain and method, as JSON lines.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benches.cameras.pose_metrics import (
    WRONG,
    area_under_curve,
    direction_error,
    rotation_error,
)
from benches.cameras.posed_photographs import PosedChain, posed_chains
from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian.cameras.find import find_cameras
from slgaussian.cameras.two_view import Photograph
from slgaussian.errors import InputError
from slgaussian.scene import View

NO_INTERVAL = (float("nan"), float("nan"))

Answer = Mapping[int, tuple[np.ndarray, np.ndarray, float, tuple[float, float]]]
"""World to camera, R [3, 3] and t [3], of the registered views; focal length in pixels; its 90 %
interval, or :data:`NO_INTERVAL`."""


def ours(views: Sequence[View]) -> Answer:
    photographs = [
        Photograph(v.name, v.image, v.camera.width, v.camera.height, lens="one") for v in views
    ]
    try:
        estimate = find_cameras(photographs)
    except InputError as refusal:
        print(f"    {refusal}")
        return {}
    for name, reason in estimate.left_out.items():
        print(f"    {name}: {reason}")
    out = {}
    for i, view in enumerate(views):
        if view.name in estimate.cameras:
            w2c, focal = estimate.cameras[view.name].w2c, estimate.focals[view.name]
            out[i] = w2c[:3, :3], w2c[:3, 3], focal.pixels, (focal.low, focal.high)
    return out


def colmap(views: Sequence[View]) -> Answer:
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    with tempfile.TemporaryDirectory() as folder:
        images, database = Path(folder, "images"), Path(folder, "database.db")
        images.mkdir()
        names = [f"{i}.png" for i in range(len(views))]
        for name, view in zip(names, views, strict=True):
            Image.fromarray(view.image).save(images / name)
        pycolmap.set_random_seed(0)
        pycolmap.extract_features(
            database,
            images,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL"),
            device=pycolmap.Device.cpu,
        )
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
        options = pycolmap.IncrementalPipelineOptions()
        options.min_model_size = 2
        options.triangulation.ignore_two_view_tracks = False
        options.mapper.init_min_tri_angle = 4.0
        options.mapper.init_min_num_inliers = 30
        models = pycolmap.incremental_mapping(database, images, Path(folder), options)
        if not models:
            return {}
        model = max(models.values(), key=lambda candidate: candidate.num_reg_images())
        out = {}
        for image in model.images.values():
            if image.has_pose:
                pose = image.cam_from_world().matrix()
                focal = float(model.cameras[image.camera_id].focal_length)
                out[names.index(image.name)] = (pose[:, :3], pose[:, 3], focal, NO_INTERVAL)
        return out


def compute_errors(chain: PosedChain, answer: Answer) -> dict[str, Any]:
    """Compute the errors of all pairs in degrees, and the relative error of the focal length."""
    errors = []
    for i, j in itertools.combinations(range(len(chain.views)), 2):
        if i not in answer or j not in answer:
            errors.append(180.0)
            continue
        (R_a, t_a, *_), (R_b, t_b, *_) = answer[i], answer[j]
        R = R_b @ R_a.T
        true = chain.views[j].camera.w2c @ chain.views[i].camera.c2w
        pose_errors = rotation_error(R, true[:3, :3]), direction_error(t_b - R @ t_a, true[:3, 3])
        errors.append(max(pose_errors))
    # All views of a chain share one focal length.
    true = chain.views[0].camera.K[0, 0]
    *_, focal, (low, high) = next(iter(answer.values()), (np.nan, NO_INTERVAL))
    has_focal = chain.focal_known and np.isfinite(focal)
    return {
        "placed": len(answer),
        "views": len(chain.views),
        "errors": errors,
        "focal": float(abs(focal / true - 1)) if has_focal else None,
        "inside": bool(low < true < high) if has_focal and np.isfinite(low) else None,
    }


def summary(group: str, method: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    errors = [error for row in rows for error in row["errors"]]
    answered = [error for error in errors if error < 180]
    focals = [row["focal"] for row in rows if row["focal"] is not None]
    inside = [row["inside"] for row in rows if row["inside"] is not None]
    wrong = np.mean([e > WRONG for e in answered]) if answered else 0.0
    return {
        "place": group,
        "method": method,
        "chains": str(len(rows)),
        "placed": f"{sum(r['placed'] for r in rows) / sum(r['views'] for r in rows):.0%}",
        "AUC 5/10/20": "/".join(f"{area:.0f}" for area in area_under_curve(errors)),
        "wrong": f"{wrong:.0%}",
        "focal off": f"{np.median(focals):.1%}" if focals else "",
        "in its 90 % interval": f"{np.mean(inside):.0%}" if inside else "",
        "s a chain": f"{np.mean([row['seconds'] for row in rows]):.1f}",
    }


def main() -> None:
    arguments = parser(__doc__, "poses.md")
    arguments.add_argument("data", type=data_folder("office_walk"), metavar="DATA")
    arguments.add_argument("--rows", type=Path)
    args = arguments.parse_args()
    methods: dict[str, Callable[[Sequence[View]], Answer]] = {"ours": ours}
    if importlib.util.find_spec("pycolmap"):
        methods["pycolmap"] = colmap
    rows: list[dict[str, Any]] = []
    for chain in posed_chains(args.data):
        for method, call in methods.items():
            start = time.process_time()
            answer = call(chain.views)
            seconds = time.process_time() - start
            row = {"group": chain.group, "name": chain.name, "method": method}
            rows.append(row | compute_errors(chain, answer) | {"seconds": seconds})
            print(f"  {chain.name} {method}: {rows[-1]['placed']}/{rows[-1]['views']}", flush=True)
    if args.rows:
        args.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    lines = []
    for group in ["all", *dict.fromkeys(row["group"] for row in rows)]:
        for method in methods:
            selected = [r for r in rows if r["method"] == method and group in ("all", r["group"])]
            lines.append(summary(group, method, selected))
    command = "python -m benches.cameras.chains DATA"
    publish(args.out, "poses.md", command, table(lines, {key: (key, str) for key in lines[0]}))


if __name__ == "__main__":
    main()
