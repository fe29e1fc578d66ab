"""Samples of clips: views at a common size, consistent labels, and lessons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.build import label_views, predict, see_targets
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.components.config import ComponentConfig
from slgaussian.datasets.re10k import Clip
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.io import KnownFile
from slgaussian.scene import Sample, opaque_pixels
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_to_arrays, sample_from_arrays, sample_to_arrays
from tasks.chunks import Framing, framed_views, left_out, read_chunk
from tasks.context import RunContext
from tasks.scene import check_held_out, geometry, masks, read_geometry
from tasks.stage import stage


@stage("framed", version=4)
def framed(
    run: RunContext, chunk: KnownFile | ArtifactRef, frames: Mapping[str, Any], framing: Framing
) -> ArtifactRef:
    """Read a sample of a chunk: spec ``sample``. ``meta["url"]`` is the URL of its video.

    ``frames`` has the names of ``sample`` and ``clip``, and the numbers of the frames of
    ``context`` and ``targets``.
    """
    clip = read_chunk(run, chunk)[frames["clip"]]
    sample = read_sample(clip, frames, framing, targets=True)
    return run.store.put("sample", sample_to_arrays(sample), {"url": clip.url})


# Its version is raised with that of the stage that labels context views alone.
@stage("all_masks", version=1000 * masks.version + 1)
def all_masks(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: ComponentConfig,
    tracker: ComponentConfig,
    replicas: int,
    votes: str,
) -> ArtifactRef:
    """Label the context and target views: spec ``labels`` of the context.

    ``meta["targets"]`` locates the labels of the targets, which have only ids of the context views.
    """
    seen = read_geometry(run, sample, gaussians)
    frames = read_targets(run, sample, gaussians)
    label_maps = label_views(seen, proposer, tracker, replicas, votes, frames)
    context, targets = label_maps.split(len(seen.frames))
    target_ref = run.store.put("labels", labels_to_arrays(targets))
    meta = {
        "objects": len(context.ids),
        "computed": label_maps.computed,
        "targets": {"uri": target_ref.uri, "digest": target_ref.digest},
        "parts": [target_ref.uri],
    }
    return run.store.put("labels", labels_to_arrays(context), meta)


def read_targets(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> list[SeenView]:
    """Return the targets with rendered depth, :func:`see_targets`, once for all stages."""
    views = run.read(sample, sample_from_arrays)
    predicted = run.read(gaussians, Gaussians.from_arrays)
    key = SeenView, sample.digest, gaussians.digest
    return run.once(key, lambda: see_targets(views, predicted))


# Its version depends on that of the stage for a single scene.
@stage("predictions", version=1000 * geometry.version + 1)
def predictions(
    run: RunContext,
    pairs: ArtifactRef,
    chunk: KnownFile | ArtifactRef,
    framing: Framing,
    predictor: ComponentConfig,
    seed: int,
    trust_cameras: bool = False,
) -> ArtifactRef:
    """Predict the Gaussians of the samples of a chunk: spec ``predictions``.

    ``meta["left_out"]`` lists samples that failed.
    """
    store, clips, loaded = run.store, read_chunk(run, chunk), predictor.load()
    rows, bad = [], []
    for row in store.get(pairs).to_pylist():
        try:
            sample = read_sample(clips[row["clip"]], row, framing, targets=False)
            graph = MatchGraph.of(sample.context)
            gaussians = predict(sample, graph, loaded, seed, trust_cameras).gaussians
            gaussians.check()
        except InputError as error:
            bad.append(left_out(row["sample"], error))
            continue
        ref = store.put("gaussians", gaussians.to_arrays())
        entry = {"sample": row["sample"], "uri": ref.uri, "digest": ref.digest}
        rows.append({**entry, "gaussians": len(gaussians)})
    table = pa.Table.from_pylist(rows, schema=load_spec("predictions").schema)
    meta = {"samples": len(rows), "left_out": bad, "parts": [row["uri"] for row in rows]}
    return store.put("predictions", table, meta)


def read_sample(clip: Clip, row: Mapping[str, Any], framing: Framing, targets: bool) -> Sample:
    """Read the sample of a row of spec ``pairs`` at the common size.

    Decoding ``targets`` takes as long as the context and is optional.

    Raises:
        InputError: If a view cannot be decoded, or the views do not make a sample, or a
            target is a copy of a context view.
    """
    context = framed_views(clip, row["context"], framing)
    target_views = framed_views(clip, row["targets"], framing) if targets else ()
    sample = Sample(row["sample"], context, target_views)
    check_held_out(sample)
    return sample


# Its version is raised with that of the stage that labels the views of a single scene.
@stage("lessons", version=1000 * masks.version + 2)
def lessons(
    run: RunContext,
    pairs: ArtifactRef,
    predictions: ArtifactRef,
    chunk: KnownFile | ArtifactRef,
    framing: Framing,
    proposer: ComponentConfig,
    tracker: ComponentConfig,
    replicas: int,
    votes: str,
) -> ArtifactRef:
    """Make the lessons of the samples of a chunk: spec ``lessons``.

    ``meta["left_out"]`` lists samples that failed.
    """
    store, clips = run.store, read_chunk(run, chunk)
    samples = {row["sample"]: row for row in store.get(pairs).to_pylist()}
    rows, bad = [], []
    for prediction in store.get(predictions).to_pylist():
        row = samples[prediction["sample"]]
        ref = ArtifactRef("gaussians", prediction["uri"], prediction["digest"])
        gaussians = Gaussians.from_arrays(store.get(ref))
        try:
            sample = read_sample(clips[row["clip"]], row, framing, targets=True)
            seen = SceneGeometry.of(sample.context, gaussians)
            frames = see_targets(sample, gaussians)
            label_maps = label_views(seen, proposer, tracker, replicas, votes, frames)
        except InputError as error:
            bad.append(left_out(prediction["sample"], error))
            continue
        context, targets = label_maps.split(len(sample.context))
        cameras, opaque = [view.camera for view in sample.targets], opaque_pixels(sample.targets)
        lesson = Lesson(
            sample.scene, gaussians, context.labels, tuple(cameras), targets.labels, opaque
        )
        ref = store.put("lesson", lesson.to_arrays())
        rows.append(_lesson_row(lesson, ref, row["clip"]))
    table = pa.Table.from_pylist(rows, schema=load_spec("lessons").schema)
    meta = {"samples": len(rows), "left_out": bad, "parts": [row["uri"] for row in rows]}
    return store.put("lessons", table, meta)


def _lesson_row(lesson: Lesson, ref: ArtifactRef, clip: str) -> dict[str, Any]:
    return {
        "sample": lesson.sample,
        "clip": clip,
        "uri": ref.uri,
        "digest": ref.digest,
        "gaussians": len(lesson.gaussians),
        "objects": int((np.unique(lesson.labels) > 0).sum()),
        "shared": int((np.unique(lesson.targets) > 0).sum()),
        "unlabelled_context": float((lesson.labels == 0).mean()),
        "unlabelled_target": float((lesson.targets == 0).mean()),
    }
