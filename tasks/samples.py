"""Samples of clips: views at a common size, consistent labels, and lessons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from slgaussian.components.component import Component
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.io import KnownFile
from slgaussian.labels import LabelMaps
from slgaussian.masks.associate import associate
from slgaussian.rasterize import rasterize
from slgaussian.scene import Sample
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_to_arrays, sample_from_arrays, sample_to_arrays
from tasks.chunks import Framing, framed_views, left_out, read_chunk
from tasks.context import RunContext
from tasks.predictions import read_sample
from tasks.scene import masks
from tasks.stage import stage


@dataclass(frozen=True)
class Frames:
    """Frame numbers of a sample in its clip."""

    sample: str
    clip: str
    context: tuple[int, ...]
    targets: tuple[int, ...]


@stage("framed", version=2)
def framed(
    run: RunContext, chunk: KnownFile | ArtifactRef, frames: Frames, framing: Framing
) -> ArtifactRef:
    """Read a sample of a chunk: spec ``sample``. ``meta["url"]`` is the URL of its video."""
    clip = read_chunk(run, chunk)[frames.clip]
    context = framed_views(clip, frames.context, framing)
    targets = framed_views(clip, frames.targets, framing)
    sample = Sample(frames.sample, context, targets)
    return run.store.put("sample", sample_to_arrays(sample), {"url": clip.url})


# Its version is raised with that of the stage that labels context views alone.
@stage("all_masks", version=1000 * masks.version + 1)
def all_masks(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: Component,
    tracker: Component,
    replicas: int,
    votes: str,
) -> ArtifactRef:
    """Label the context and target views: spec ``labels`` of the context.

    ``meta["targets"]`` locates the labels of the targets, which have only ids of the context views.
    """
    frames = read_everywhere(run, sample, gaussians)
    label_maps = associate(frames, proposer.load(), tracker.load(), replicas, votes)
    count = len(run.read(sample, sample_from_arrays).context)
    context = LabelMaps(label_maps.labels[:count], label_maps.margin[:count])
    targets = LabelMaps(
        known_alone(label_maps.labels[count:], context.labels), label_maps.margin[count:]
    )
    target_ref = run.store.put("labels", labels_to_arrays(targets))
    meta = {
        "objects": len(context.ids),
        "computed": label_maps.computed,
        "targets": {"uri": target_ref.uri, "digest": target_ref.digest},
        "parts": [target_ref.uri],
    }
    return run.store.put("labels", labels_to_arrays(context), meta)


def read_everywhere(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> list[SeenView]:
    """Read the views of :func:`seen_everywhere` once for all stages."""

    def make() -> list[SeenView]:
        predicted = run.read(gaussians, Gaussians.from_arrays)
        return seen_everywhere(run.read(sample, sample_from_arrays), predicted)

    return run.once((SeenView, sample.digest, gaussians.digest), make)


def seen_everywhere(sample: Sample, gaussians: Gaussians) -> list[SeenView]:
    """Return the context views with depth of their Gaussians, and targets with rendered depth."""
    nothing = torch.zeros(len(gaussians), 1)
    targets = []
    for view in sample.targets:
        # Mean depth would put a surface between foreground and background at edges.
        depth = rasterize(gaussians, nothing, view.camera, median=True).median
        targets.append(SeenView(view, None if depth is None else depth.numpy()))
    return [*SceneGeometry.of(sample.context, gaussians).frames, *targets]


def known_alone(targets: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Remove objects from target labels that no context view shows, as they have no code."""
    return np.where(np.isin(targets, np.unique(labels)), targets, 0).astype(np.int32)


# Its version is raised with that of the stage that labels the views of a single scene.
@stage("lessons", version=1000 * masks.version + 1)
def lessons(
    run: RunContext,
    pairs: ArtifactRef,
    predictions: ArtifactRef,
    chunk: KnownFile | ArtifactRef,
    framing: Framing,
    proposer: Component,
    tracker: Component,
    replicas: int,
    votes: str,
) -> ArtifactRef:
    """Make the lessons of the samples of a chunk: spec ``lessons``.

    ``meta["left_out"]`` lists samples that failed.
    """
    store, clips = run.store, read_chunk(run, chunk)
    samples = {row["sample"]: row for row in store.get(pairs).to_pylist()}
    propose = proposer.load()
    rows, bad = [], []
    for prediction in store.get(predictions).to_pylist():
        row = samples[prediction["sample"]]
        ref = ArtifactRef("gaussians", prediction["uri"], prediction["digest"])
        gaussians = Gaussians.from_arrays(store.get(ref))
        try:
            sample = read_sample(clips[row["clip"]], row, framing, targets=True)
            frames = seen_everywhere(sample, gaussians)
            label_maps = associate(frames, propose, tracker.load(), replicas, votes)
        except InputError as error:
            bad.append(left_out(prediction["sample"], error))
            continue
        count = len(sample.context)
        labels, target_labels = label_maps.labels[:count], label_maps.labels[count:]
        cameras = tuple(view.camera for view in sample.targets)
        targets = known_alone(target_labels, labels)
        lesson = Lesson(sample.scene, gaussians, labels, cameras, targets)
        ref = store.put("lesson", lesson.to_arrays())
        rows.append({**row_of(lesson, ref), "clip": row["clip"]})
    table = pa.Table.from_pylist(rows, schema=load_spec("lessons").schema)
    meta = {"samples": len(rows), "left_out": bad, "parts": [row["uri"] for row in rows]}
    return store.put("lessons", table, meta)


def row_of(lesson: Lesson, ref: ArtifactRef) -> dict[str, Any]:
    """Return the row of spec ``lessons`` of a stored lesson, without its clip and chunk."""
    context_ids, target_ids = np.unique(lesson.labels), np.unique(lesson.targets)
    return {
        "sample": lesson.sample,
        "uri": ref.uri,
        "digest": ref.digest,
        "gaussians": len(lesson.gaussians),
        "objects": int((context_ids > 0).sum()),
        "shared": int((target_ids > 0).sum()),
        "unlabelled_context": float((lesson.labels == 0).mean()),
        "unlabelled_target": float((lesson.targets == 0).mean()),
    }
