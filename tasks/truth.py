"""What the queries of one scene should find: from label files, or exact where the data know it."""

from __future__ import annotations

from slgaussian.benchmark.annotations import read_truth
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.storage.store import ArtifactRef, ArtifactStore
from tasks.artifacts import sample_from_arrays, truth_to_arrays
from tasks.stage import StageCall

STAGE = "truth"
VERSION = 2


def run(store: ArtifactStore, call: StageCall) -> ArtifactRef:
    """Spec ``truth``. Settings: categories, files (hashes of the label files). Inputs: sample.

    ``where["labels"]`` is the folder of labels; without it truth comes from instance ids.
    """
    sample = sample_from_arrays(store.get(call.inputs["sample"]))
    if "labels" in call.where:
        truth = read_truth(call.where["labels"], call.settings["categories"], sample.targets)
    else:
        truth = truth_from_instances(sample)
    return store.put("truth", truth_to_arrays(truth, sample))
