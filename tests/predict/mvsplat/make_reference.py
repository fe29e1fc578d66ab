"""How ``reference.npz`` was made; run again only to change what is in it.

``python make_reference.py PARITY.pt STATE_DICT.txt WIGNER.npz``. The first holds inputs, outputs
and intermediates of the published implementation (github donydchen/mvsplat 175b17a, float32 on the
CPU) at 64 x 64 with the weights of ``benches/predict/random_mvsplat_weights.py``, and for each the
largest difference between two ways to compute it ("floor": oneDNN on and off). The second lists
names and shapes of its weights, the third rotations of harmonics by e3nn 0.6. Kept of each stage:
values at places drawn at random by its name.
"""

import hashlib
import sys
import zlib
from pathlib import Path

import numpy as np
import torch

FILE = Path(__file__).with_name("reference.npz")
COUNT = 2000


def places(name: str, size: int) -> np.ndarray:
    """Flat indices of a stage's values that are kept."""
    return np.random.default_rng(zlib.crc32(name.encode())).integers(0, size, COUNT)


def digest(lines: list[str]) -> str:
    """Of the names and shapes of all weights, in order."""
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def main(parity: str, names: str, wigner: str) -> None:
    stored = torch.load(parity, weights_only=True)
    floor = stored["noise_floor_absmax_mkldnn_off"]
    remaining = {f"input/{name}": value[0].numpy() for name, value in stored["inputs"].items()}
    for name, value in stored["outputs"].items():
        remaining[f"{name}"] = value.numpy().ravel()[places(name, value.numel())]
        remaining[f"floor/{name}"] = np.float32(floor[name])
    lines = [line for line in Path(names).read_text().splitlines() if not line.startswith("#")]
    remaining["names"] = np.array(digest(lines))
    rotations = np.load(wigner)
    for key in ("R", "dirs", *(f"{kind}{d}" for kind in "DY" for d in range(4))):
        remaining[f"e3nn/{key}"] = rotations[key]
    np.savez_compressed(FILE, **remaining)


if __name__ == "__main__":
    main(*sys.argv[1:])
