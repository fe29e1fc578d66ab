"""Labels of the contexts and targets of all samples of a chunk, and the lessons they make."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark.pictures import contact_sheet, encode_png, paint_labels
from slgaussian.components.component import Component
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.io import KnownFile
from slgaussian.masks.associate import associate
from slgaussian.scene import Sample
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.all_masks import known_alone, seen_everywhere
from tasks.chunks import Framing, left_out, read_chunk
from tasks.context import RunContext
from tasks.masks import masks
from tasks.predictions import read_sample
from tasks.stage import stage

SHEET_ROWS = 24
"""Most samples on a contact sheet."""

SHEET_SIDE = 144
"""Pixels of a picture on it."""


# Its version is raised with that of the stage that labels the views of a single scene.
@stage("lessons", version=1000 * masks.version + 1)
def lessons(
    run: RunContext,
    pairs: ArtifactRef,
    predictions: ArtifactRef,
    chunk: KnownFile,
    framing: Framing,
    proposer: Component,
    tracker: Component,
    replicas: int,
) -> ArtifactRef:
    """Lessons of the samples of a chunk: spec ``lessons``.

    ``meta`` has the contact sheet's place in the store (spec ``sheet``) and, under ``left_out``,
    the samples that could not be done.
    """
    store, clips = run.store, read_chunk(run, chunk)
    samples = {row["sample"]: row for row in store.get(pairs).to_pylist()}
    propose = proposer.load()
    rows, bad, tiles = [], [], []
    for made in store.get(predictions).to_pylist():
        row = samples[made["sample"]]
        ref = ArtifactRef("gaussians", made["uri"], made["digest"])
        gaussians = Gaussians.from_arrays(store.get(ref))
        try:
            sample = read_sample(clips[row["clip"]], row, framing, targets=True)
            seen = seen_everywhere(sample, gaussians)
            found = associate(seen, propose, tracker.load(), replicas)
        except InputError as error:
            bad.append(left_out(made["sample"], error))
            continue
        lesson = _lesson(sample, gaussians, found.labels)
        ref = store.put("lesson", lesson.to_arrays())
        rows.append({**row_of(lesson, ref), "clip": row["clip"]})
        if len(rows) <= SHEET_ROWS:
            tiles += _tiles(sample, lesson)
    parts, sheet = [row["uri"] for row in rows], None
    if tiles:
        columns = len(tiles) // min(len(rows), SHEET_ROWS)
        png = encode_png(contact_sheet(tiles, SHEET_SIDE, columns))
        sheet = store.put("sheet", {"png": np.frombuffer(png, np.uint8)})
        parts.append(sheet.uri)
    table = pa.Table.from_pylist(rows, schema=load_spec("lessons").schema)
    meta = {"samples": len(rows), "left_out": bad, "parts": parts}
    if sheet is not None:
        meta["sheet"] = {"uri": sheet.uri, "digest": sheet.digest}
    return store.put("lessons", table, meta)


def _lesson(sample: Sample, gaussians: Gaussians, found: np.ndarray) -> Lesson:
    count = len(sample.context)
    labels, targets = found[:count], known_alone(found[count:], found[:count])
    cameras = tuple(view.camera for view in sample.targets)
    return Lesson(sample.scene, gaussians, labels, cameras, targets)


def row_of(lesson: Lesson, ref: ArtifactRef) -> dict[str, Any]:
    """A stored lesson as a row of spec ``lessons``, without its clip and chunk."""
    ids, seen = np.unique(lesson.labels), np.unique(lesson.targets)
    return {
        "sample": lesson.sample,
        "uri": ref.uri,
        "digest": ref.digest,
        "gaussians": len(lesson.gaussians),
        "objects": int((ids > 0).sum()),
        "shared": int((seen > 0).sum()),
        "unlabelled_context": float((lesson.labels == 0).mean()),
        "unlabelled_target": float((lesson.targets == 0).mean()),
    }


def _tiles(sample: Sample, lesson: Lesson) -> list[tuple[str, np.ndarray]]:
    """A row of the contact sheet: each photograph, then its labels over it."""
    tiles = []
    views, labels = (*sample.context, *sample.targets), (*lesson.labels, *lesson.targets)
    for number, (view, own) in enumerate(zip(views, labels, strict=True)):
        role = "context" if number < len(sample.context) else "target"
        caption = sample.scene if not number else f"{role} {view.name}"
        without = f"{(own == 0).mean():.0%} without an id"
        tiles += [(caption, view.image), (without, paint_labels(own, view.image))]
    return tiles
