"""What the queries of one scene should find: from label files, or exact where the data know it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from slgaussian.benchmark.annotations import Truth, label_files, read_truth
from slgaussian.benchmark.evaluate import truth_from_instances
from slgaussian.scene import Sample
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import sample_from_arrays, truth_to_arrays
from tasks.context import RunContext
from tasks.ingest import digests_of
from tasks.stage import stage


@dataclass(frozen=True)
class Labels:
    """The label files of some targets, and which categories are read of them.

    ``folder`` is None where truth comes from instance ids.
    """

    folder: Path | None
    targets: tuple[str, ...]
    categories: tuple[str, ...]

    def of_views(self, names: Sequence[str]) -> Labels:
        """Take full names of targets, which decide in which folder their labels are looked for."""
        return replace(self, targets=tuple(names))

    @cached_property
    def files(self) -> dict[str, str]:
        """SHA-256 of every label file, by its path below the folder."""
        if self.folder is None:
            return {}
        files = [file for target in self.targets for file in label_files(self.folder, target)]
        return digests_of(files, self.folder)

    def identity(self) -> dict[str, Any]:
        """What truth depends on: not where the files are, but what is in them."""
        drawn = self.folder is not None
        return {"categories": self.categories, "drawn": drawn, "files": self.files}

    def read(self, sample: Sample) -> Truth:
        """What should be found in the targets of a sample; InputError if labels cannot be read."""
        if self.folder is None:
            return truth_from_instances(sample)
        return read_truth(self.folder, self.categories, sample.targets)


@stage("truth", version=3)
def truth(run: RunContext, sample: ArtifactRef, labels: Labels) -> ArtifactRef:
    """What should be found in the targets: spec ``truth``."""
    shown = run.read(sample, sample_from_arrays)
    found = labels.read(shown)
    return run.store.put("truth", truth_to_arrays(found, shown))
