"""Answers and cost of fields on splats that exist already, by the predictor ``gaussians``.

    python -m benches.semantic.existing_splats [-o docs/measured] [--rooms 8]

Rooms are procedural, with exact depth; two photographs of each are labelled, and all queries of its
objects are scored in two other views. ``exact`` is a splat of the exact surfaces that six views
show; ``exported`` is the field's own, written as a standard .ply and read without its own columns.
Cost is that of ``slgaussian field scene.ply``, with a room of so many Gaussians and photographs.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from benches.common.harness import parser, publish, table
from benches.common.process_cost import CLI, costing
from slgaussian import datasets
from slgaussian.benchmark.metrics import iou
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.formats.splats import save_gaussians
from slgaussian.gaussians import Gaussians
from slgaussian.predict.unproject import unproject
from slgaussian.scene import Sample, Scene

PAGE = "splats.md"
CONTEXT, TARGETS = ("view_00", "view_05"), ("view_02", "view_03")
VIEWS, GAUSSIANS = (2, 5, 10, 20, 50), (100_000, 500_000, 2_000_000)


def exact_splat(scene: Scene, names: list[str], height: int, width: int) -> Gaussians:
    """Return the exact surfaces of views, a Gaussian a pixel."""
    views = [scene.read(name).resize(height, width) for name in names]
    return unproject(
        [view.camera for view in views],
        [view.image.astype(np.float32) / 255 for view in views],
        [1 / view.depth for view in views],
        [np.full(view.depth.shape, 0.99, np.float32) for view in views],
    )


def score(field: SemanticField, sample: Sample) -> tuple[float, float]:
    """Return the mean IoU and the share of point hits over all visible objects of the targets."""
    scores = []
    for target in sample.targets:
        view = field.render(target.camera)
        for instance, phrase in sample.phrases.items():
            truth = target.instances == instance
            if truth.any():
                hit = view.query(phrase)
                inside = hit.point is not None and bool(truth[hit.point[1], hit.point[0]])
                scores.append((iou(hit.mask, truth), inside))
    return tuple(np.mean(scores, 0).tolist())


def rooms(count: int) -> list[dict]:
    """Score the field of photographs, and those on both splats, in each room."""
    rows = []
    for seed in range(count):
        scene = datasets.load("procedural", seed=seed, views=6)
        sample = scene.sample(CONTEXT, TARGETS)
        own = build_field(sample)
        splats = {
            "exact": (exact_splat(scene, list(scene.cameras), 312, 432), None),
            "exported": (own.gaussians, own.cameras),
        }
        row = {"room": str(seed)}
        row["photographs"], row["photographs_hit"] = score(own, sample)
        for name, (splat, cameras) in splats.items():
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "splat.ply"
                save_gaussians(splat, file, cameras=cameras)
                method = Method("gaussians", settings={"gaussians": {"splat": file}})
                row[name], row[f"{name}_hit"] = score(build_field(sample, method), sample)
        rows.append(row)
        print(row, flush=True)
    names = [name for name in rows[0] if name != "room"]
    return [*rows, {"room": "mean"} | {n: float(np.mean([r[n] for r in rows])) for n in names}]


def costs() -> list[dict]:
    """Measure the command over numbers of photographs and of Gaussians."""
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        scene = datasets.load("procedural", views=max(VIEWS), baseline=2.0)
        frames = []
        for name, camera in scene.cameras.items():
            Image.fromarray(scene.read(name).image).save(folder / f"{name}.png")
            (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
            size = {
                "w": camera.width,
                "h": camera.height,
                "fl_x": fx,
                "fl_y": fy,
                "cx": cx,
                "cy": cy,
            }
            pose = (camera.c2w * [1, -1, -1, 1]).tolist()
            frames.append({"file_path": f"{name}.png", "transform_matrix": pose, **size})
        (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
        names = list(scene.cameras)
        for number in GAUSSIANS:
            side = (number / 6 / (3 / 4)) ** 0.5
            splat = exact_splat(scene, names[::9], round(side * 3 / 4), round(side))
            save_gaussians(splat, folder / f"{number}.ply")
        for views, number in [(v, 500_000) for v in VIEWS] + [(20, n) for n in GAUSSIANS]:
            chosen = [names[i] for i in np.linspace(0, len(names) - 1, views).round().astype(int)]
            words = [*CLI, "field", folder / f"{number}.ply", "--cameras", folder]
            for name in chosen:
                words += ["--photographs", folder / f"{name}.png"]
            cost = costing([*words, "-o", folder / "field", "--force"])
            rows.append({"views": views, "gaussians": number, "cpu": cost.cpu, "peak": cost.peak})
            print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, and write the page."""
    arguments = parser(__doc__, PAGE)
    arguments.add_argument("--rooms", type=int, default=8)
    options = arguments.parse_args()
    names = ("photographs", "exact", "exported")
    columns = {"room": ("room", str)}
    columns |= {name: (f"{name}: IoU", ".3f") for name in names}
    columns |= {f"{name}_hit": (f"{name}: point", ".2f") for name in names}
    costly = {"views": ("photographs", "d"), "gaussians": ("Gaussians", ",d")}
    costly |= {"cpu": ("processor s", ".1f"), "peak": ("peak MB", ",.0f")}
    parts = table(rooms(options.rooms), columns), table(costs(), costly)
    publish(options.out, PAGE, "python -m benches.semantic.existing_splats", *parts)


if __name__ == "__main__":
    main()
