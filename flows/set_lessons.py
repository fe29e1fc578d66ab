"""The samples of a training set as lessons of the semantic branch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import torch

from slgaussian.datasets.training_set import TrainingSet
from slgaussian.gaussians import Gaussians
from slgaussian.scene import Camera
from slgaussian.semantic.lesson import GEOMETRY, Lesson
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore
from tasks.lessons import row_of


def read_set(folder: Path, split: str, store: ArtifactStore) -> pa.Table:
    """Put the samples of a split into the store as lessons; a table of spec ``lessons``.

    The clip of a lesson is the place of the sample: what is judged is judged by places.

    Raises
    ------
    InputError
        If the split has no sample.
    SpecError
        If a sample is damaged or has no Gaussians.
    """
    samples = TrainingSet(folder, split)
    rows: list[dict[str, Any]] = []
    for index in range(len(samples)):
        lesson = lesson_of(samples, index)
        ref = store.put("lesson", lesson.to_arrays())
        rows.append({**row_of(lesson, ref), "clip": samples.rows["place"][index].as_py()})
    table = pa.Table.from_pylist(rows, schema=load_spec("lessons").schema)
    return table.sort_by("sample")


def lesson_of(samples: TrainingSet, index: int) -> Lesson:
    """One sample as a lesson; SpecError as :func:`read_set`."""
    members = samples.members(index)
    geometry, labels, gaussians = (
        samples.arrays(index, name, members) for name in ("geometry", "labels", "gaussians")
    )
    count = len(geometry["confirmed"])
    height, width = geometry["depth"].shape[1:]
    cameras = tuple(
        Camera(K, c2w, width, height, near or None, far or None)
        for K, c2w, (near, far) in zip(
            geometry["K"], geometry["c2w"], geometry["near_far"].tolist(), strict=True
        )
    )
    kept = {name: torch.from_numpy(gaussians[name]) for name in GEOMETRY}
    return Lesson(
        samples.rows["sample"][index].as_py(),
        Gaussians(**kept, sh=torch.zeros(len(kept["means"]), 0, 3)),
        labels["labels"][:count],
        cameras[count:],
        labels["labels"][count:],
    )
