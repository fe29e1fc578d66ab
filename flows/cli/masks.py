"""Label photographs, in the format that the tracker precomputed reads."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flows.cli.load_views import load_views
from flows.cli.text import aligned
from flows.settings import make_settings
from slgaussian.benchmark import pictures
from slgaussian.build import predict
from slgaussian.geometry import SceneGeometry
from slgaussian.io import atomic_folder
from slgaussian.labels import LabelMaps
from slgaussian.masks.associate import associate
from slgaussian.masks.precomputed import encode_ids, map_names
from slgaussian.storage.field_folder import check_target

ABOUT = "masks.json"
LOOK = "look.jpg"
"""A picture for people. Not a PNG, so that no view is called like it."""

STEPS = ("predictor", "proposer", "tracker")


def label(
    photos: Sequence[str], cameras: Path | None, refine: bool, out: Path, values: dict[str, Any]
) -> tuple[dict[str, str], LabelMaps]:
    """Label the objects of photographs and write the maps to folder ``out``.

    The predictor serves the tracker, which wants depth; no word is read and no field is made.
    ``out`` has one map a view, ``masks.json`` with what made them, and ``look.jpg``. A folder that
    this made is replaced. ``values`` are settings as a configuration file has them.

    Returns
    -------
    files : dict str -> str
        The file of each view, by the view's name.
    maps : LabelMaps

    Raises
    ------
    InputError
        If anything given cannot be used; a folder that cannot be written is found before the work.
    """
    method = make_settings(values, "masks")
    check_target(out, ABOUT, "a folder of masks")
    sample, _ = load_views(photos, cameras, refine, method)
    names = map_names([view.name for view in sample.context])
    parts = [method.part(step) for step in STEPS]
    predictor, proposer, tracker = parts
    made_by = proposer.load(), tracker.load()
    height, width = sample.context[0].image.shape[:2]
    called = ", ".join(part.name for part in parts)
    print(
        f"labelling {len(names)} views of {width}x{height} with {called}",
        file=sys.stderr,
    )
    start = time.perf_counter()
    gaussians = predict(sample, predictor, method.seed, method.trust_cameras).gaussians
    geometry = SceneGeometry.of(sample.context, gaussians)
    maps = associate(geometry.seen, *made_by, method.replicas)
    print(f"{len(maps.ids)} objects, {time.perf_counter() - start:.1f} s", file=sys.stderr)

    files, panels = {}, []
    with atomic_folder(out) as draft:
        for view, ids in zip(sample.context, maps.labels, strict=True):
            suffix, data = encode_ids(ids)
            files[view.name] = names[view.name] + suffix
            file = draft / files[view.name]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
            painted = pictures.paint_labels(ids, view.image)
            panels += [(view.name, view.image), ("objects", painted)]
        look = pictures.side_by_side(panels)
        (draft / LOOK).write_bytes(pictures.encode_jpeg(look, look.shape[1]))
        about: dict[str, Any] = {part.kind: part.name for part in parts} | {
            "replicas": method.replicas
        }
        about |= {part.name: part.identity() for part in parts if part.settings}
        text = {"size": [height, width], "views": files, "settings": about}
        (draft / ABOUT).write_text(json.dumps(text, indent=1) + "\n", "utf-8")
    return files, maps


def maps_table(files: Mapping[str, str], maps: LabelMaps) -> str:
    """Tabulate the maps, and count the objects that several views show."""
    rows = [("view", "file", "objects", "labelled")]
    counts = (maps.areas() > 0).sum(0)
    for (view, file), ids, n in zip(files.items(), maps.labels, counts, strict=True):
        rows.append((view, file, str(n), f"{100 * (ids > 0).mean():.1f} %"))
    shared = len(maps.ids) - len(maps.seen_once)
    objects = f"{len(maps.ids)} objects, {shared} of them in several views"
    return f"{aligned(rows, '<<')}\n{objects}"
