"""Made-up rooms with as many objects as wanted, whose ids are exactly known in every view.

A room has at most some twenty objects. For more, the largest are cut into pieces in space: a point
belongs to the nearest of some centres spread over its object, whatever view sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from slgaussian import datasets
from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.predict import load_predictor
from slgaussian.scene import Camera, Sample, View

SIZE = (416, 576)
MOST_WHOLE = 20
"""Objects above which they are cut."""
ENOUGH = 3000
"""Points of an object among which its centres are looked for."""


@dataclass(frozen=True, eq=False)
class Room:
    """Gaussians predicted from two views, their true labels, and novel views with theirs."""

    name: str
    gaussians: Gaussians
    label_maps: LabelMaps
    cameras: list[Camera]
    truths: list[np.ndarray]

    @property
    def rows(self) -> torch.Tensor:
        """The object of each Gaussian, counted from 1 in the order of ids; 0 for none."""
        labels = self.label_maps.labels.ravel()[self.gaussians.source.numpy()]
        rows = np.searchsorted(self.label_maps.ids, labels) + 1
        return torch.from_numpy(np.where(labels > 0, rows, 0).astype(np.int32))


def make_rooms(seed: int, counts: tuple[int, ...]) -> list[Room]:
    """The room of a seed with about each of ``counts`` objects, two views between the ends."""
    made: dict[int, tuple[Sample, Gaussians]] = {}
    rooms = []
    for count in counts:
        free = 1 if count < 10 else 12
        if free not in made:
            scene = datasets.load(
                "procedural", seed=seed, objects=free, height=SIZE[0], width=SIZE[1]
            )
            names = list(scene.cameras)
            sample = scene.sample([names[0], names[-1]], names[1:-1])
            made[free] = sample, load_predictor("planesweep")(sample)
        sample, gaussians = made[free]
        views = [*sample.context, *sample.targets]
        labels = [view.instances for view in views]
        if count > MOST_WHOLE:
            labels = cut(views, len(sample.context), count, np.random.default_rng(seed))
        given = np.stack(labels[: len(sample.context)]).astype(np.int32)
        rooms.append(
            Room(
                f"{sample.scene}, {count}",
                gaussians,
                LabelMaps(given, np.ones(given.shape, np.float32)),
                [view.camera for view in sample.targets],
                labels[len(sample.context) :],
            )
        )
    return rooms


def cut(views: list[View], given: int, count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Ids of ``count`` pieces in each view, judged by the first ``given`` of them."""
    points = [view.camera.unproject(view.depth.astype(np.float64)) for view in views]
    areas = np.bincount(np.concatenate([view.instances.ravel() for view in views[:given]]))
    pieces = {i: 1 for i in np.flatnonzero(areas).tolist() if i}
    while sum(pieces.values()) < count:
        largest = max(pieces, key=lambda i: areas[i] / pieces[i])
        pieces[largest] += 1
    labels, first = [np.zeros_like(view.instances) for view in views], 1
    for i, wanted in pieces.items():
        seen = [
            p[view.instances == i] for p, view in zip(points[:given], views[:given], strict=True)
        ]
        tree = cKDTree(_spread(np.concatenate(seen), wanted, rng))
        for p, view, out in zip(points, views, labels, strict=True):
            mine = view.instances == i
            if mine.any():
                out[mine] = first + tree.query(p[mine])[1]
        first += wanted
    return labels


def _spread(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """``count`` of the points, each as far as possible from those before it."""
    some = points[rng.choice(len(points), min(len(points), ENOUGH), replace=False)]
    chosen = [some[0]]
    far = np.linalg.norm(some - some[0], axis=1)
    for _ in range(count - 1):
        chosen.append(some[far.argmax()])
        far = np.minimum(far, np.linalg.norm(some - chosen[-1], axis=1))
    return np.array(chosen)
