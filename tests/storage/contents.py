"""Artifacts to keep in the stores of the tests."""

import numpy as np
import pyarrow as pa

from slgaussian.storage.specs import load_spec


def labels(value: int = 3) -> dict[str, np.ndarray]:
    maps = np.full((2, 4, 5), value, np.int32)
    return {"labels": maps, "margin": np.full((2, 4, 5), 0.5, np.float32)}


def failures(*scenes: str) -> pa.Table:
    rows = [{"scene": s, "stage": "masks", "kind": "InputError", "reason": "why"} for s in scenes]
    return pa.Table.from_pylist(rows, schema=load_spec("failures").schema)


def weights(size: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Return incompressible bytes."""
    return {"safetensors": np.random.default_rng(seed).integers(0, 256, size, np.uint8)}
