"""Set the field of a scene against another field of it, from the same viewpoints."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa

from slgaussian.benchmark import metrics
from slgaussian.cameras.trajectories import between
from slgaussian.field import FieldView
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef
from tasks.artifacts import get_field, sample_from_arrays
from tasks.stage import Worksite, stage


@stage("agreement", version=1)
def agreement(
    site: Worksite, sample: ArtifactRef, reference: ArtifactRef, field: ArtifactRef
) -> ArtifactRef:
    """How far a field shows what the field ``reference`` shows: spec ``agreement``.

    Both are drawn at the targets of ``sample``, and halfway between its first two cameras.
    """
    seen = site.read(sample, sample_from_arrays)
    first, second = (view.camera for view in seen.context[:2])
    cameras = {view.name: view.camera for view in seen.targets}
    cameras["halfway"] = between(first, second, 0.5)
    one, other = (get_field(site.store, ref) for ref in (reference, field))
    rows = [
        {"frame": frame, **_compared(one.render(camera), other.render(camera))}
        for frame, camera in cameras.items()
    ]
    table = pa.Table.from_pylist(rows, schema=load_spec("agreement").schema)
    covered = float(np.mean([row["covering"] for row in rows]))
    return site.store.put("agreement", table, {"covering": covered})


def _compared(one: FieldView, other: FieldView) -> dict[str, Any]:
    psnr = metrics.psnr(one.rgb, other.rgb)
    both = (one.depth > 0) & (other.depth > 0)
    moved = np.abs(other.depth[both] - one.depth[both]) / one.depth[both]
    return {
        "covering": metrics.covering(one.ids, other.ids),
        "psnr": None if math.isinf(psnr) else psnr,
        "depth": float(np.median(moved)) if both.any() else None,
    }
