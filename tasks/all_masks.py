"""Label maps of the context views of a sample and of its targets, with one id for one object."""

from __future__ import annotations

import numpy as np
import torch

from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.labels import LabelMaps
from slgaussian.masks.associate import associate
from slgaussian.parts.part import Part
from slgaussian.rasterize import rasterize
from slgaussian.scene import Sample
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_to_arrays, sample_from_arrays
from tasks.context import RunContext
from tasks.masks import masks
from tasks.stage import stage


# Its version is raised with that of the stage that labels context views alone.
@stage("all_masks", version=1000 * masks.version + 1)
def all_masks(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: Part,
    tracker: Part,
    replicas: int,
) -> ArtifactRef:
    """Labels of the context views: spec ``labels``; ``meta["targets"]`` is the place of the others.

    The targets have the ids of the context views and no others.
    """
    seen = read_everywhere(run, sample, gaussians)
    found = associate(seen, proposer.load(), tracker.load(), replicas)
    count = len(run.read(sample, sample_from_arrays).context)
    context = LabelMaps(found.labels[:count], found.margin[:count])
    targets = LabelMaps(known_alone(found.labels[count:], context.labels), found.margin[count:])
    others = run.store.put("labels", labels_to_arrays(targets))
    meta = {
        "objects": len(context.ids),
        "computed": found.computed,
        "targets": {"uri": others.uri, "digest": others.digest},
        "parts": [others.uri],
    }
    return run.store.put("labels", labels_to_arrays(context), meta)


def read_everywhere(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> list[SeenView]:
    """:func:`seen_everywhere` of stored ones; made once for all stages that ask for it."""

    def make() -> list[SeenView]:
        found = run.read(gaussians, Gaussians.from_arrays)
        return seen_everywhere(run.read(sample, sample_from_arrays), found)

    return run.once((SeenView, sample.digest, gaussians.digest), make)


def seen_everywhere(sample: Sample, gaussians: Gaussians) -> list[SeenView]:
    """The contexts with the depth of their own Gaussians, the targets with rendered depth."""
    nothing = torch.zeros(len(gaussians), 1)
    targets = []
    for view in sample.targets:
        # The mean would put a surface between what is before and behind an edge.
        depth = rasterize(gaussians, nothing, view.camera, median=True).median
        targets.append(SeenView(view, None if depth is None else depth.numpy()))
    return [*SceneGeometry.of(sample.context, gaussians).seen, *targets]


def known_alone(targets: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Labels of targets without objects that no context view shows: they have no code."""
    return np.where(np.isin(targets, np.unique(labels)), targets, 0).astype(np.int32)
