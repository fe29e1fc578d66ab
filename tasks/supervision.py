"""ID codes and the memory bank of one scene: what a field is taught."""

from __future__ import annotations

from slgaussian.build import remember
from slgaussian.parts.part import Part
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import labels_from_arrays, sample_from_arrays
from tasks.context import RunContext
from tasks.geometry import read_geometry
from tasks.stage import stage


@stage("supervision", version=5)
def supervision(
    run: RunContext,
    sample: ArtifactRef,
    gaussians: ArtifactRef,
    labels: ArtifactRef,
    encoder: Part,
    codes: Part,
    seed: int,
    held: str,
) -> ArtifactRef:
    """A code and vectors of every object: spec ``bank``.

    The code images of the paper are ``bank.codes`` looked up by the label maps, so they are not
    stored again.
    """
    bank = remember(
        run.read(sample, sample_from_arrays),
        read_geometry(run, sample, gaussians),
        run.read(labels, labels_from_arrays),
        encoder,
        codes,
        seed,
        held,
    )
    return run.store.put("bank", bank.to_arrays(), {"objects": len(bank)})
