"""Base Gaussians from the context views of one scene."""

from __future__ import annotations

from slgaussian.build import predict
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.components.component import Component
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import sample_from_arrays
from tasks.context import RunContext
from tasks.stage import stage


@stage("geometry", version=10)
def geometry(
    run: RunContext,
    sample: ArtifactRef,
    predictor: Component,
    seed: int,
    trust_cameras: bool = False,
) -> ArtifactRef:
    """What the predictor makes of the context views: spec ``gaussians``.

    ``meta["quality"]`` says how good the views were, ``meta["depths"]`` how many were compared of
    how many, or None.
    """
    shown = run.read(sample, sample_from_arrays)
    if "matches" in sample.meta:
        stored = ArtifactRef("matches", **sample.meta["matches"])
        graph = MatchGraph.from_arrays(run.store.get(stored))
    else:  # of a clip
        graph = MatchGraph.of(shown.context)
    gaussians, quality, depths = predict(shown, graph, predictor, seed, trust_cameras)
    gaussians.check()
    meta = {"gaussians": len(gaussians), "quality": quality.as_json(), "depths": depths}
    return run.store.put("gaussians", gaussians.to_arrays(), meta)


def read_geometry(run: RunContext, sample: ArtifactRef, gaussians: ArtifactRef) -> SceneGeometry:
    """The context views and their surfaces; made once for all stages that ask for it.

    Scattering Gaussians into depth takes less time than inflating a stored copy.
    """

    def make() -> SceneGeometry:
        shown = run.read(sample, sample_from_arrays)
        return SceneGeometry.of(shown.context, run.read(gaussians, Gaussians.from_arrays))

    return run.once((SceneGeometry, sample.digest, gaussians.digest), make)
