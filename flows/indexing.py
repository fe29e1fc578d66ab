"""Choice of context views for labelled frames: the index file of a labelled set."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flows.config import IndexSettings
from slgaussian import datasets
from slgaussian.benchmark.annotations import labelled_frames
from slgaussian.benchmark.index import Index, ScenePair, write_index
from slgaussian.copies import Thumbnail, are_copies
from slgaussian.datasets.configs import Rule
from slgaussian.datasets.labelled_sets import LABELS
from slgaussian.datasets.pair_selection import Views, surround
from slgaussian.datasets.sharpness import blur, exposure, small
from slgaussian.errors import InputError
from slgaussian.predict.distance import typical_depths
from slgaussian.scene import Scene


def build_index(data: Path, labels: Path | None, settings: IndexSettings, out: Path) -> Index:
    """Choose two context views for every labelled frame of a set, and write the index file.

    Labels are those of the format, or are in the folder ``labels``, in one subfolder per scene if
    the format has several scenes.

    Raises:
        InputError: If the data cannot be read, nothing is labelled, or no labelled frame has a
            pair.
    """
    rule = Rule.of(settings)
    pairs: dict[str, ScenePair] = {}
    left_out: dict[str, str] = {}
    for name, options, place in label_places(data, labels, settings.format):
        scene = datasets.load(settings.format, data, **options)
        frames = labelled_frames((labels or data) / place)
        for frame, pair in _choose_pairs(scene, frames, rule).items():
            pair_name = f"{name}-{frame.replace('/', '-')}"
            if pair_name in pairs or pair_name in left_out:
                raise InputError(
                    f"{labels or data}: two labelled frames would both be called {pair_name!r}; "
                    f"rename {frame} or the other"
                )
            if isinstance(pair, str):
                left_out[pair_name] = pair
            else:
                pairs[pair_name] = ScenePair(options=options, labels=place, **pair)
    if not pairs:
        text = "; ".join(f"{name}: {reason}" for name, reason in list(left_out.items())[:3])
        raise InputError(f"{labels or data}: no labelled frame has a pair ({text or 'no labels'})")
    index = Index(format=settings.format, rule=rule.describe(), scenes=pairs, left_out=left_out)
    write_index(out, index)
    return index


def label_places(
    data: Path, labels: Path | None, format: str
) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Yield the labelled scenes of a folder: name, options of the reader, and folder of labels.

    The folder is relative to ``labels``, or to ``data`` if the format includes labels.

    Raises:
        InputError: If the format reads no folder, or includes no labels and none are given.
    """
    datasets.check_format(format)
    if labels is None and format not in LABELS:
        raise InputError(
            f"data format {format!r} has no labels of its own; give their folder with --labels"
        )
    for name, options in datasets.scenes(format, data).items():
        if labels is None:
            place = LABELS[format].format(scene=name)
        else:
            place = name if options else ""  # of a folder of several scenes
        if ((labels or data) / place).exists():
            yield name, options, place


def _choose_pairs(
    scene: Scene, frames: Mapping[str, tuple[str, ...]], rule: Rule
) -> dict[str, dict[str, Any] | str]:
    """Return fields of the :class:`ScenePair` of every labelled frame, or the reason of none."""
    names, clip, pictures, unreadable = _look(scene)
    place = {view: i for i, view in enumerate(names)}
    out: dict[str, Any] = dict.fromkeys(frames, "nothing is labelled in it")
    targets, excluded = {}, set()
    for frame, categories in frames.items():
        try:
            view = scene.find(frame)
        except InputError as error:
            out[frame] = str(error)
            continue
        if view in unreadable:
            out[frame] = unreadable[view]
            continue
        excluded.add(place[view])
        if categories:
            targets[frame] = place[view]
    # A copy of a target is no context for it, under whatever name.
    excluded |= {
        number
        for number, picture in enumerate(pictures)
        if any(are_copies(pictures[target], picture) for target in targets.values())
    }
    surrounding = surround(clip, list(targets.values()), excluded, rule)
    for (frame, number), pair in zip(targets.items(), surrounding, strict=True):
        if isinstance(pair, str):
            out[frame] = pair
            continue
        measures = ("overlap", "baseline", "cover", "aside", "score")
        measured = {measure: round(getattr(pair, measure), 4) for measure in measures}
        context = tuple(names[i] for i in pair.context)
        out[frame] = {"context": context, "target": (names[number],)}
        out[frame] |= {"categories": frames[frame], "measured": measured}
    return out


def _look(scene: Scene) -> tuple[list[str], Views, list[Thumbnail], dict[str, str]]:
    """Measure and shrink the readable views of a scene; return the reasons of the others."""
    names, greys, pictures, unreadable = [], [], [], {}
    for name in scene.cameras:
        try:
            view = scene.read(name)
            greys.append(small(view.image))
            pictures.append(view.thumbnail)
            names.append(name)
        except InputError as error:
            unreadable[name] = str(error)
    cameras = [
        scene.cameras[name].resize(*grey.shape[::-1])
        for name, grey in zip(names, greys, strict=True)
    ]
    mean, clipped = np.array([exposure(grey) for grey in greys]).reshape(-1, 2).T
    blurs = np.array([blur(grey) for grey in greys])
    clip = Views(cameras, typical_depths(greys, cameras), blurs, mean, clipped)
    return names, clip, pictures, unreadable
