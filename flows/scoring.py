"""Scoring of masks of external methods on the data and labels of a benchmark."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flows.benchmark import RUN_FILES, find_scenes
from flows.config import SceneSettings, Settings
from flows.indexing import label_places
from flows.runners.session import check_folder
from flows.scene import evaluation, labels, photographs, target_size
from flows.scenes import find_data_folder
from slgaussian import datasets
from slgaussian.benchmark.annotations import Truth, labelled_frames, read_truth
from slgaussian.benchmark.external_predictions import (
    SCORABLE,
    JudgedScene,
    Predictions,
    read_predictions,
    score_predictions,
)
from slgaussian.benchmark.outputs import write_masks, write_samples
from slgaussian.benchmark.protocols import load_protocol
from slgaussian.benchmark.scores import Rows
from slgaussian.errors import InputError
from slgaussian.formats import rle


@dataclass(frozen=True)
class Scores:
    """Samples of all methods, the counted masks, and messages for the user."""

    samples: Rows
    predictions: Predictions
    messages: list[str]


def score(settings: Settings, place: Path, protocols: Sequence[str], out: Path) -> Scores:
    """Score the masks in a folder or JSON file, and write tables and masks to ``out``.

    ``protocols`` default to those of the masks.

    Raises:
        InputError: If data, labels or masks cannot be read, no mask belongs to a query, or ``out``
            is the folder of a run or cannot be written. Then nothing is written.
    """
    for name in protocols:
        load_protocol(name)
        if name not in SCORABLE:
            raise InputError(
                f"protocol: {name!r} scores relevancies, which masks do not have; expected one of "
                f"{', '.join(SCORABLE)}"
            )
    if settings.size not in ("auto", target_size(settings.size)):
        raise InputError(
            f"size: found {settings.size!r}, expected HEIGHTxWIDTH, or nothing: all masks are "
            "scored at one size"
        )
    if any((out / name).exists() for name in RUN_FILES):
        raise InputError(
            f"{out}: has the results of a run, which would be replaced; choose another folder with "
            "-o"
        )
    predictions = read_predictions(place, protocols)
    chosen = [load_protocol(name) for name in dict.fromkeys(protocols or predictions.protocols)]
    by_labels = settings.data and settings.pairs is None and settings.rooms is None
    scenes, messages = ([], []) if by_labels else find_scenes(settings)
    judged = _by_labels(settings) if by_labels else _by_scenes(settings, scenes)
    parts, masks = [], []
    for result in score_predictions(predictions, judged, chosen):
        parts.append(Rows.from_rows(result.rows))
        encoded = {key: rle.encode(mask) for key, mask in result.predictions.items()}
        masks.append((result.method, result.scene, encoded))
    if not predictions.used:
        listed = ", ".join(predictions.extra[:3])
        raise InputError(
            f"{predictions.place}: no mask belongs to a query (found {listed}); name scenes, "
            "frames and queries as the data and labels do"
        )
    check_folder(out)
    write_masks(masks, out)
    samples = Rows.join(parts)
    write_samples(samples, out)
    return Scores(samples, predictions, messages)


def _by_scenes(settings: Settings, scenes: Sequence[SceneSettings]) -> Iterator[JudgedScene]:
    for scene in scenes:
        scene_settings = evaluation(settings, scene)
        truth = labels(scene).read(photographs(settings, scene).read())
        yield JudgedScene(scene.name, scene_settings.dataset, scene_settings.place, truth)


def _by_labels(settings: Settings) -> Iterator[JudgedScene]:
    """Yield the labelled frames of the data, whose queries are their labels."""
    data, format = settings.data, settings.format or "nerfstudio"
    if data is None:
        raise InputError("data is missing; give the folder of the photographs with --data")
    root = settings.labels or data
    places = list(label_places(data, settings.labels, format))
    if not places:
        raise InputError(f"{root}: found no labels; give their folder")
    for name, options, place in places:
        scene = datasets.load(format, data, **options)
        texts = {frame: of for frame, of in labelled_frames(root / place).items() if of}
        if not texts:
            raise InputError(f"{root / place}: no frame is labelled; label one, or give others")
        views = scene.views(list(texts), target_size(settings.size))
        masks: dict[str, Any] = {}
        boxes: dict[str, Any] = {}
        opaque: dict[str, Any] = {}
        for view, of_frame in zip(views, texts.values(), strict=True):
            truth = read_truth(root / place, of_frame, [view])
            masks |= truth.masks
            boxes |= truth.boxes
            opaque |= truth.opaque
        yield JudgedScene(name, find_data_folder(data).name, None, Truth(masks, boxes, opaque))
