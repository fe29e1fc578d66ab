"""Lessons to train and evaluate liftings: procedural rooms with known objects, and real pairs.

A room takes seconds to make, so rooms are stored in a folder.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from benches.common.photograph_pairs import load_samples
from slgaussian import datasets
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.io import write_atomic
from slgaussian.kernels.seeding import rng_for
from slgaussian.masks import load_proposer, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.predict import load_predictor
from slgaussian.rasterize import rasterize
from slgaussian.scene import Sample, View
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.encoding import encode_arrays
from slgaussian.storage.specs import load_spec

SIZE = 96
LEARN_SIZE, REAL_SIZE = (128, 176), (160, 224)
"""Size of photographs for training, and for evaluation; their ratio is that of the paper."""
VIEWS = 6
TRAINING = range(1000, 1160)
HELD_OUT = range(5000, 5032)
"""Seeds of the rooms for training and for evaluation."""


class Rooms(Sequence[Lesson]):
    """Rooms of some seeds, at 96x96: context is the ends of an arc, targets are four views between.

    Labels are the true objects. ``mask_labels`` returns the labels that the mask stage assigns to
    the context views, each id replaced by the true object that covers most of it.
    """

    def __init__(self, folder: Path, seeds: Sequence[int]) -> None:
        self.folder, self.seeds = folder, seeds

    def __len__(self) -> int:
        return len(self.seeds)

    def __getitem__(self, index: int) -> Lesson:
        return Lesson.from_arrays(dict(np.load(self._file(index))))

    def mask_labels(self, index: int) -> np.ndarray:
        masks, labels = np.load(self._masks(index)), self[index].labels
        named = np.zeros_like(masks)
        for mask in np.unique(masks[masks > 0]):
            inside = masks == mask
            named[inside] = np.bincount(labels[inside]).argmax()
        return named

    def make(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        for index, seed in enumerate(self.seeds):
            if not self._file(index).is_file():
                sample = room(seed)
                gaussians = load_predictor("planesweep")(sample)
                np.save(self._masks(index), association(sample.context, gaussians))
                true = [np.stack([v.instances for v in vs]).astype(np.int32)
                        for vs in (sample.context, sample.targets)]  # fmt: skip
                lesson = lesson_of(sample, gaussians, *true)
                write_atomic(
                    self._file(index), encode_arrays(lesson.to_arrays(), load_spec("lesson"))
                )

    def _file(self, index: int) -> Path:
        return self.folder / f"{self.seeds[index]}.npz"

    def _masks(self, index: int) -> Path:
        return self.folder / f"{self.seeds[index]}.masks.npy"


def room(seed: int) -> Sample:
    rng = rng_for(seed, "lesson", "room")
    scene = datasets.load(
        "procedural",
        seed=seed,
        views=VIEWS,
        height=SIZE,
        width=SIZE,
        baseline=float(np.round(rng.uniform(0.3, 1.0), 2)),
        objects=int(rng.integers(4, 15)),
    )
    names = list(scene.cameras)
    # Small views have too few matches to estimate these bounds; depths are 1.6 to 5.4 in rooms.
    return scene.sample([names[0], names[-1]], names[1:-1], near=1.4, far=6.0)


def real_lessons(data: Path, size: tuple[int, int] = REAL_SIZE) -> list[Lesson]:
    """Return lessons of the pairs of a nerfstudio folder, with labels by the mask stage."""
    lessons = []
    for name, sample in load_samples(data, size).items():
        gaussians = load_predictor("planesweep")(sample)
        labels = association(sample.context, gaussians, sample.targets)
        lessons.append(lesson_of(sample, gaussians, labels[:2], labels[2:], name))
    return lessons


def association(
    context: Sequence[View], gaussians: Gaussians, targets: Sequence[View] = ()
) -> np.ndarray:
    """Return label maps int32 of all views; the depth of targets is rendered from the Gaussians."""
    views = list(SceneGeometry.of(context, gaussians).frames)
    nothing = torch.zeros(len(gaussians), 1)
    for view in targets:
        # The mean would create a surface between foreground and background at an edge.
        drawn = rasterize(gaussians, nothing, view.camera, median=True)
        views.append(SeenView(view, drawn.median.numpy()))
    return associate(views, load_proposer(), load_tracker(), 5).labels


def lesson_of(
    sample: Sample,
    gaussians: Gaussians,
    labels: np.ndarray,
    targets: np.ndarray,
    name: str | None = None,
) -> Lesson:
    cameras = tuple(view.camera for view in sample.targets)
    return Lesson(name or sample.scene, gaussians, labels, cameras, targets)
