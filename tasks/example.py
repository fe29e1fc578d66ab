"""One sample of a training set in the format of its shard, with measures of its quality."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from itertools import permutations
from typing import Any

import numpy as np
from PIL import Image

from slgaussian.datasets.shards import pack
from slgaussian.scene import Sample, opaque_pixels
from slgaussian.storage.encoding import Arrays, encode_artifact
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_from_arrays, labels_to_arrays, sample_from_arrays
from tasks.context import RunContext
from tasks.samples import read_targets
from tasks.scene import read_geometry
from tasks.stage import stage

SAVE_OPTIONS: dict[str, dict[str, Any]] = {
    "jpg": {"format": "JPEG", "quality": 95, "subsampling": 0},
    "png": {"format": "PNG", "compress_level": 6},
}
"""Pillow's save options of images by file extension."""


@stage("example", version=2)
def example(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    bank: ArtifactRef,
    known: Mapping[str, Any],
    images: str,
) -> ArtifactRef:
    """Encode a sample as a part of a tar file: spec ``example``.

    ``meta["about"]`` has ``known`` and measures of quality, and ``meta["opaque"]`` the fraction of
    opaque pixels, if not all are.

    Args:
        sample, gaussians, labels, bank: Results of earlier stages; ``labels`` of
            :func:`tasks.samples.all_masks`.
        known: Properties that are stored with the sample. Its ``sample`` is the name of the
            members.
        images: A key of :data:`SAVE_OPTIONS`.
    """
    store = run.store
    views = run.read(sample, sample_from_arrays)
    context = run.read(labels, labels_from_arrays)
    targets = labels_from_arrays(store.get(ArtifactRef("labels", **labels.meta["targets"])))
    key, quality = known["sample"], gaussians.meta["quality"]
    height, width = context.labels.shape[1:]
    description = {
        **known,
        "url": sample.meta["url"],
        "height": height,
        "width": width,
        "objects": len(context.ids),
        "gaussians": gaussians.meta["gaussians"],
        "unlabelled": float((context.labels == 0).mean()),
        "unlabelled_targets": float((targets.labels == 0).mean()),
        "confirmed": float(quality["confirmed"]),
        "explained": float(quality["explained"]),
    }
    label_maps = labels_to_arrays(context), labels_to_arrays(targets)
    labels_of_all = {
        name: np.concatenate([maps[name] for maps in label_maps]) for name in label_maps[0]
    }
    members, geometry = _images(views, images), _geometry(run, sample, gaussians)
    arrays: dict[str, tuple[str, Arrays]] = {
        "geometry": ("example_geometry", geometry),
        "labels": ("labels", labels_of_all),
        "bank": ("bank", store.get(bank)),
    }
    for name, (spec, content) in arrays.items():
        members[f"{name}.npz"] = encode_artifact(spec, content, f"{key}.{name}.npz")[1]
    members["about.json"] = json.dumps(description, sort_keys=True, allow_nan=False).encode()
    data = pack(key, members)
    meta = {"about": description, "length": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    if "opaque" in geometry:
        meta["opaque"] = float(geometry["opaque"].mean())
    return store.put("example", {"tar": np.frombuffer(data, np.uint8)}, meta)


def _images(sample: Sample, ending: str) -> dict[str, bytes]:
    members = {}
    for role, views in (("context", sample.context), ("target", sample.targets)):
        for number, view in enumerate(views):
            out = io.BytesIO()
            Image.fromarray(view.image).save(out, **SAVE_OPTIONS[ending])
            members[f"{role}_{number}.{ending}"] = out.getvalue()
    return members


def _geometry(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> Arrays:
    views = run.read(sample, sample_from_arrays)
    origin = views.localize()[1].origin  # readers take poses as float32
    cameras = [v.camera.relative_to(origin) for v in (*views.context, *views.targets)]
    geometry = read_geometry(run, sample, gaussians)
    confirmed = np.zeros(geometry.depths.shape, bool)
    for first, second in permutations(range(len(confirmed)), 2):
        confirmed[first] |= geometry.seen_again(first, second)[1]
    targets = [frame.require_depth() for frame in read_targets(run, sample, gaussians)]
    # Only where a view is transparent: the bytes of other samples stay as they were.
    opaque = opaque_pixels([*views.context, *views.targets])
    return {
        **({} if opaque is None else {"opaque": opaque}),
        "K": np.stack([camera.K for camera in cameras]),
        "c2w": np.stack([camera.c2w for camera in cameras]),
        "near_far": np.array([[c.near or 0, c.far or 0] for c in cameras], np.float64),
        "depth": np.stack([*geometry.depths, *targets]).astype(np.float32),
        "confirmed": confirmed,
        **({"origin": origin} if origin.any() else {}),
    }
