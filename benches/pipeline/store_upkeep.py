"""What it takes to look after a store of many artifacts, and to read one with its digest.

``python -m benches.pipeline.store_upkeep [--count 100000]``: makes a store of tiny artifacts in a
temporary folder, each named by a record, times `gc` and `verify` on it and says how much
memory they took; then the parts of a read, for artifacts of the usual sizes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import tracemalloc
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benches.common.machine import measured
from slgaussian.storage.encoding import arrays_digest, decode_arrays, encode_arrays
from slgaussian.storage.housekeeping import collect, verify
from slgaussian.storage.records import FOLDER
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore, address


def fill(root: Path, count: int) -> None:
    """A store of ``count`` artifacts and as many records; nothing refers to every tenth."""
    for number in range(count):
        arrays = {"safetensors": np.frombuffer(number.to_bytes(8), np.uint8)}
        digest = arrays_digest(arrays)
        ref = ArtifactRef("weights", address("weights", digest), digest)
        key = f"{digest[::-1]}.json"
        _write(root / ref.uri, encode_arrays(arrays, load_spec(ref.spec)))
        if number % 10:
            _write(root / FOLDER / "train" / "v1" / key[:2] / key, json.dumps(asdict(ref)).encode())


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def walks(count: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        fill(Path(folder), count)
        store = ArtifactStore(folder)
        works = {
            "gc": lambda: collect(store, age=-60),
            "verify": lambda: verify(store),
        }
        for name, work in works.items():
            start, used = time.perf_counter(), time.process_time()
            work()
            took, cpu = time.perf_counter() - start, time.process_time() - used
            tracemalloc.start()
            found = work()
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            print(f"{name:<7} {took:6.1f} s, {cpu:6.1f} s of CPU, {peak / 1e6:6.1f} MB  {found}")


def reads() -> None:
    """Milliseconds of CPU for the parts of reading an artifact, least of five."""
    random = np.random.default_rng(0)
    pixels = 2 * 416 * 576
    cases = {
        "labels": {
            "labels": np.kron(
                random.integers(0, 60, (2, 26, 36), np.int32), np.ones((16, 16), np.int32)
            ),
            "margin": np.ones((2, 416, 576), np.float32),
        },
        "gaussians": {
            "means": random.normal(size=(pixels, 3)).astype(np.float32),
            "scales": random.random((pixels, 3), np.float32),
            "quats": random.normal(size=(pixels, 4)).astype(np.float32),
            "opacities": random.random(pixels, np.float32),
            "sh": random.normal(size=(pixels, 1, 3)).astype(np.float32),
            "source": np.arange(pixels, dtype=np.int32),
        },
    }
    for spec, arrays in cases.items():
        rules = load_spec(spec)
        data = encode_arrays(arrays, rules)
        parts = {
            "decode": lambda data=data, rules=rules: decode_arrays(data, rules, "file"),
            "spec": lambda arrays=arrays, rules=rules: rules.check_arrays(arrays, "file"),
            "digest": lambda arrays=arrays: arrays_digest(arrays),
        }
        told = ", ".join(f"{name} {least(part):.1f} ms" for name, part in parts.items())
        print(f"{spec}, a file of {len(data) / 1e6:.1f} MB: {told}")


def least(work) -> float:
    times = []
    for _ in range(5):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1000 * min(times)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    print(measured())
    walks(parser.parse_args().count)
    reads()
