"""Label maps of the context views of one scene."""

from __future__ import annotations

from slgaussian.build import label_views
from slgaussian.gaussians import Gaussians
from slgaussian.parts.part import Part
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_to_arrays, sample_from_arrays
from tasks.stage import Worksite, stage


@stage("masks", version=2)
def masks(
    site: Worksite,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    proposer: Part,
    tracker: Part,
    replicas: int,
) -> ArtifactRef:
    """Object ids that agree across the context views: spec ``labels``."""
    label_maps = label_views(
        site.read(sample, sample_from_arrays),
        site.read(gaussians, Gaussians.from_arrays),
        proposer,
        tracker,
        replicas,
    )
    return site.store.put("labels", labels_to_arrays(label_maps), {"objects": len(label_maps.ids)})
