"""Label maps of the context views of one scene."""

from __future__ import annotations

from slgaussian.build import label_views
from slgaussian.parts.part import Part
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_to_arrays
from tasks.context import RunContext
from tasks.geometry import read_geometry
from tasks.stage import stage


@stage("masks", version=6)
def masks(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: Part,
    tracker: Part,
    replicas: int,
) -> ArtifactRef:
    """Object ids that agree across the context views: spec ``labels``.

    ``meta["computed"]`` says how many copies of a view were segmented.
    """
    label_maps = label_views(read_geometry(run, sample, gaussians), proposer, tracker, replicas)
    meta = {"objects": len(label_maps.ids), "computed": label_maps.computed}
    return run.store.put("labels", labels_to_arrays(label_maps), meta)
