"""Conversion of the library's objects to stored arrays and back."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple
from typing import TypeVar

import numpy as np
from PIL import Image

from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.formats import rle
from slgaussian.formats.images import open_image
from slgaussian.formats.resampling import Window
from slgaussian.labels import LabelMaps
from slgaussian.scene import Camera, Estimated, Sample, View
from slgaussian.storage.encoding import Arrays
from slgaussian.storage.field_folder import About
from slgaussian.storage.provenance import current_provenance, record_provenance
from slgaussian.storage.store import ArtifactRef, ArtifactStore, address

Key = TypeVar("Key")

TARGET = "target_"
"""Prefix of the names of arrays of target views."""


def sample_to_arrays(sample: Sample) -> Arrays:
    """Convert a sample to spec ``sample``; InputError unless its targets have one size."""
    arrays = {
        "scene": np.array(sample.scene),
        "phrase_ids": np.array(sorted(sample.phrases), np.int32),
        "phrases": np.array([sample.phrases[i] for i in sorted(sample.phrases)], np.str_),
        **_views_to_arrays(sample.scene, sample.context),
    }
    if sample.targets:
        targets = _views_to_arrays(sample.scene, sample.targets)
        arrays |= {TARGET + name: array for name, array in targets.items()}
    if sample.estimation:
        arrays["found"] = np.array(json.dumps(dict(sample.estimation), sort_keys=True))
    return arrays


def sample_from_arrays(arrays: Arrays) -> Sample:
    """Inverse of :func:`sample_to_arrays`; a truth map without a known pixel becomes None."""
    ids, phrases = arrays["phrase_ids"].tolist(), arrays["phrases"].tolist()
    estimation = json.loads(str(arrays["found"])) if "found" in arrays else {}
    of_targets = {n.removeprefix(TARGET): a for n, a in arrays.items() if n.startswith(TARGET)}
    context = _views_from_arrays(arrays)
    targets = _views_from_arrays(of_targets) if of_targets else ()
    phrases_by_id = dict(zip(ids, phrases, strict=True))
    return Sample(str(arrays["scene"]), context, targets, phrases_by_id, estimation)


def _views_to_arrays(scene: str, views: Sequence[View]) -> Arrays:
    first = views[0]
    for view in views:
        if view.image.shape != first.image.shape:
            (h0, w0), (h1, w1) = first.image.shape[:2], view.image.shape[:2]
            raise InputError(
                f"scene {scene!r}: {view.name!r} is {w1}x{h1} and {first.name!r} is "
                f"{w0}x{h0}; give a size (height and width) that all views are brought to"
            )
    arrays = {
        "names": np.array([view.name for view in views]),
        "images": np.stack([view.image for view in views]),
        "K": np.stack([view.camera.K for view in views]),
        "c2w": np.stack([view.camera.c2w for view in views]),
        "near_far": np.array([[v.camera.near or 0.0, v.camera.far or 0.0] for v in views]),
    }
    optional = ("depth", 0, np.float32), ("instances", 0, np.int32), ("opaque", 1, np.uint8)
    for name, fill, dtype in optional:
        maps = [getattr(view, name) for view in views]
        if any(pixels is not None for pixels in maps):
            blank = np.full(first.image.shape[:2], fill)
            stack = np.stack([blank if pixels is None else pixels for pixels in maps])
            arrays[name] = stack.astype(dtype)
    if any(view.window is not None for view in views):
        arrays["window"] = np.array([astuple(view.visible_window) for view in views], np.float64)
    if any(view.namesakes for view in views):
        arrays["namesakes"] = np.array([json.dumps(view.namesakes) for view in views], np.str_)
    estimates = [view.camera.estimated for view in views]
    if any(estimates):
        texts = [json.dumps(asdict(estimate)) if estimate else "" for estimate in estimates]
        arrays["estimated"] = np.array(texts, np.str_)
    return arrays


def _views_from_arrays(arrays: Arrays) -> tuple[View, ...]:
    height, width = arrays["images"].shape[1:3]

    def truth(name: str, index: int) -> np.ndarray | None:
        available = name in arrays and arrays[name][index].any()
        return arrays[name][index] if available else None

    def read_estimate(index: int) -> Estimated | None:
        text = str(arrays["estimated"][index]) if "estimated" in arrays else ""
        return Estimated.of(json.loads(text)) if text else None

    def window(index: int) -> Window | None:
        if "window" not in arrays:
            return None
        photo_width, photo_height, *edges = arrays["window"][index].tolist()
        return Window(int(photo_width), int(photo_height), *edges)

    return tuple(
        View(
            name=str(name),
            camera=Camera(
                arrays["K"][i],
                arrays["c2w"][i],
                width,
                height,
                near=float(arrays["near_far"][i, 0]) or None,
                far=float(arrays["near_far"][i, 1]) or None,
                estimated=read_estimate(i),
            ),
            image=arrays["images"][i],
            depth=truth("depth", i),
            instances=truth("instances", i),
            opaque=None if "opaque" not in arrays else arrays["opaque"][i] > 0,
            window=window(i),
            namesakes=tuple(json.loads(str(arrays["namesakes"][i])))
            if "namesakes" in arrays
            else (),
        )
        for i, name in enumerate(arrays["names"])
    )


def labels_to_arrays(label_maps: LabelMaps) -> Arrays:
    """Convert label maps to spec ``labels``."""
    return {"labels": label_maps.labels, "margin": label_maps.margin}


def labels_from_arrays(arrays: Arrays) -> LabelMaps:
    """Inverse of :func:`labels_to_arrays`."""
    return LabelMaps(arrays["labels"], arrays["margin"])


def truth_to_arrays(truth: Truth, sample: Sample) -> Arrays:
    """Convert ground truth to spec ``truth``."""
    by_view, has_boxes = truth.masks, bool(truth.boxes)
    keys = [(view, query) for view, masks in by_view.items() for query in masks]
    boxes = [truth.boxes[view][query] if has_boxes else np.zeros((0, 4)) for view, query in keys]
    judged = sample.targets or sample.context
    size = judged[0].image.shape[:2]
    return {
        "views": np.array([view for view, _ in keys], np.str_),
        "queries": np.array([query for _, query in keys], np.str_),
        "masks": np.array([by_view[v][q] for v, q in keys], bool).reshape(len(keys), *size),
        "box_masks": np.repeat(np.arange(len(keys), dtype=np.int32), [len(b) for b in boxes]),
        "boxes": np.concatenate([np.zeros((0, 4)), *boxes]),
        "has_boxes": np.array(has_boxes),
    }


def truth_from_arrays(arrays: Arrays) -> Truth:
    """Inverse of :func:`truth_to_arrays`; without annotated boxes ``boxes`` is empty."""
    masks: dict[str, dict[str, np.ndarray]] = {}
    boxes: dict[str, dict[str, np.ndarray]] = {}
    for i, (view, query) in enumerate(zip(arrays["views"], arrays["queries"], strict=True)):
        masks.setdefault(str(view), {})[str(query)] = arrays["masks"][i]
        if arrays["has_boxes"]:
            view_boxes = arrays["boxes"][arrays["box_masks"] == i]
            boxes.setdefault(str(view), {})[str(query)] = view_boxes
    return Truth(masks, boxes)


def put_field(store: ArtifactStore, field: SemanticField) -> ArtifactRef:
    """Store a field: spec ``field``, whose parts are the other files of its folder.

    ``meta`` has the numbers of ``gaussians`` and ``objects``, and the ``account``.
    """
    counts = {"gaussians": len(field.gaussians), "objects": len(field.bank)}
    with record_provenance(current_provenance() or field.provenance()):
        refs = {spec: store.put(spec, content) for spec, content in field.contents().items()}
        digests = {spec: ref.digest for spec, ref in refs.items()}
        description = About(field.settings, field.cameras, digests).to_json()
        parts = [ref.uri for ref in refs.values()]
        extra = {"account": field.settings.get("account"), "parts": parts}
        return store.put("field", {"about": np.array(description)}, counts | extra)


def about_field(store: ArtifactStore, ref: ArtifactRef) -> tuple[About, dict[str, ArtifactRef]]:
    """Read the description of a stored field and the refs of its parts by spec."""
    description, _ = About.from_json(str(store.get(ref)["about"]), f"{store.root}/{ref.uri}")
    parts = {
        spec: ArtifactRef(spec, address(spec, digest), digest)
        for spec, digest in description.digests.items()
    }
    return description, parts


def get_field(
    store: ArtifactStore, ref: ArtifactRef, places: Mapping[str, str] | None = None
) -> SemanticField:
    """Inverse of :func:`put_field`; ``places`` are the locations of the encoder's files."""
    description, parts = about_field(store, ref)
    arrays = {spec: store.get(parts[spec]) for spec in ("gaussians", "bank")}
    return SemanticField.from_arrays(description, arrays, places)


def result_to_arrays(result: SceneResult) -> Arrays:
    """Convert a scene's result to spec ``scene_result``, without its volatile timings."""
    masks = list(map(rle.encode, result.predictions.values()))
    prediction_ends, prediction_counts = _pack(mask.counts.encode() for mask in masks)
    picture_ends, picture_png = _pack(map(_png, result.pictures.values()))
    return {
        **{name: np.array(getattr(result, name)) for name in ("scene", "dataset", "method")},
        "rows": np.array(json.dumps(result.rows, allow_nan=False)),
        "metrics": np.array(json.dumps(result.scene_metrics, allow_nan=False)),
        "prediction_names": np.array(list(result.predictions), np.str_).reshape(-1, 3),
        "prediction_sizes": np.array([mask[:2] for mask in masks], np.int64).reshape(-1, 2),
        "prediction_ends": prediction_ends,
        "prediction_counts": prediction_counts,
        "picture_names": np.array(list(result.pictures), np.str_),
        "picture_ends": picture_ends,
        "picture_png": picture_png,
    }


def result_from_arrays(arrays: Arrays) -> SceneResult:
    """Inverse of :func:`result_to_arrays`, without pictures and masks, which are slow to decode."""
    return SceneResult(
        scene=str(arrays["scene"]),
        dataset=str(arrays["dataset"]),
        method=str(arrays["method"]),
        rows=json.loads(str(arrays["rows"])),
        scene_metrics=json.loads(str(arrays["metrics"])),
        predictions={},
        pictures={},
    )


def decode_predictions(arrays: Arrays) -> dict[tuple[str, str, str], rle.RunLengths]:
    """Return the predicted masks of spec ``scene_result`` by protocol, frame, query."""
    keys = [tuple(names) for names in arrays["prediction_names"].tolist()]
    counts = _unpack(arrays["prediction_ends"], arrays["prediction_counts"])
    sizes = arrays["prediction_sizes"].tolist()
    masks = (rle.RunLengths(h, w, c.decode()) for (h, w), c in zip(sizes, counts, strict=True))
    return dict(zip(keys, masks, strict=True))


def decode_pictures(arrays: Arrays) -> dict[str, bytes]:
    """Return the pictures of spec ``scene_result`` as PNG files by name."""
    blobs = _unpack(arrays["picture_ends"], arrays["picture_png"])
    return dict(zip(arrays["picture_names"].tolist(), blobs, strict=True))


def decode_pngs(files: Mapping[Key, bytes]) -> dict[Key, np.ndarray]:
    """Decode PNG files by name."""
    images = {}
    for name, png in files.items():
        with open_image(io.BytesIO(png)) as image:
            images[name] = np.asarray(image)
    return images


def _png(image: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image).save(out, "PNG", compress_level=1)
    return out.getvalue()


def _pack(blobs: Iterable[bytes]) -> tuple[np.ndarray, np.ndarray]:
    blobs = list(blobs)
    ends = np.cumsum([len(blob) for blob in blobs], dtype=np.int64)
    return ends, np.frombuffer(b"".join(blobs), np.uint8)


def _unpack(ends: np.ndarray, data: np.ndarray) -> list[bytes]:
    starts = [0, *ends][:-1]
    return [data[a:b].tobytes() for a, b in zip(starts, ends, strict=True)]
