"""Samples of clips: views at a common size, consistent labels, and lessons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa

from slgaussian.build import label_views, make_lesson, predict, see_targets
from slgaussian.components.config import ComponentConfig
from slgaussian.datasets.clip_views import Framing
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SeenView
from slgaussian.io import KnownFile
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_to_arrays, sample_from_arrays, sample_to_arrays
from tasks.chunks import left_out, read_chunk
from tasks.context import RunContext
from tasks.scene import geometry, masks, read_geometry
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
    sample = framing.read_sample(clip, frames, targets=True)
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
    label_maps = label_views(seen, proposer.load(), tracker.load(), replicas, votes, frames)
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
            sample = framing.read_sample(clips[row["clip"]], row, targets=False)
            gaussians = predict(sample, loaded, seed, trust_cameras).gaussians
        except InputError as error:
            bad.append(left_out(row["sample"], error))
            continue
        ref = store.put("gaussians", gaussians.to_arrays())
        entry = {"sample": row["sample"], "uri": ref.uri, "digest": ref.digest}
        rows.append({**entry, "gaussians": len(gaussians)})
    table = pa.Table.from_pylist(rows, schema=load_spec("predictions").schema)
    meta = {"samples": len(rows), "left_out": bad, "parts": [row["uri"] for row in rows]}
    return store.put("predictions", table, meta)


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
    segmenter = proposer.load()
    rows, bad = [], []
    for prediction in store.get(predictions).to_pylist():
        row = samples[prediction["sample"]]
        ref = ArtifactRef("gaussians", prediction["uri"], prediction["digest"])
        gaussians = Gaussians.from_arrays(store.get(ref))
        try:
            sample = framing.read_sample(clips[row["clip"]], row, targets=True)
            # A tracker remembers: each sample has its own.
            masking = segmenter, tracker.load(), replicas, votes
            lesson = make_lesson(sample, gaussians, *masking)
        except InputError as error:
            bad.append(left_out(prediction["sample"], error))
            continue
        ref = store.put("lesson", lesson.to_arrays())
        location = {"clip": row["clip"], "uri": ref.uri, "digest": ref.digest}
        rows.append({"sample": lesson.sample, **location, **lesson.counts()})
    table = pa.Table.from_pylist(rows, schema=load_spec("lessons").schema)
    meta = {"samples": len(rows), "left_out": bad, "parts": [row["uri"] for row in rows]}
    return store.put("lessons", table, meta)
