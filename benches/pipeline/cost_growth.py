"""Scaling of CPU seconds and memory with the size of the input, with exponents.

    python -m benches.pipeline.cost_growth [-o docs/measured] [--only WHAT ...]

All scenes are procedural. Each point runs in its own process, after a smaller input that loads
imports and kernels. It measures CPU seconds, the median of three runs if one is short, and the
memory that the process adds to its input. The exponent is the slope of the logarithms over the
larger half of the range: 1 is linear.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.resident_memory import give_back, memory_status, reset_peak_memory

RANGES: Mapping[str, tuple[float, ...]] = {
    "texts": (1, 10, 100, 1000),
    "objects": (5, 50, 500),
    "Gaussians": (50_000, 200_000, 1_000_000, 5_000_000),
    "pixels": (0.1, 0.2, 0.4, 0.8, 2.0),
    "views": (2, 6, 12, 25, 50),
}
"""Varied quantities and their values; pixels are megapixels per view."""

SAYS = {
    "texts": "asking one view of 416x576 pixels and 60 objects",
    "objects": "a new view's first question: reading ids and one answer, 416x576 pixels",
    "Gaussians": "drawing six channels at 416x576 pixels on all cores",
    "pixels": "a whole field of a made-up room, two views",
    "views": "a whole field of a made-up room, 240x320 pixels a view",
}
TIMES = 3
SHORT = 2.0
"""Seconds below which a job runs several times."""


def exponent(sizes: list[float], costs: list[float]) -> float:
    """Compute the slope of log cost over log size for the larger half of the sizes."""
    upper = slice(len(sizes) // 2 - (len(sizes) % 2 == 0), None)
    return float(np.polyfit(np.log(sizes[upper]), np.log(np.maximum(costs[upper], 1e-9)), 1)[0])


def job(axis: str, size: float) -> Callable[[], object]:
    """Return the measured function for one size; its preparation is not measured."""
    return {
        "texts": _texts,
        "objects": _objects,
        "Gaussians": _gaussians,
        "pixels": lambda s: _field(2, s),
        "views": lambda s: _field(int(s), 0.0768),
    }[axis](size)


def _queries(objects: int, count: int) -> tuple[Callable[[], object], Callable[[], object]]:
    from slgaussian.language import load_encoder
    from slgaussian.language.answer import ask
    from slgaussian.language.bank import MemoryBank
    from slgaussian.language.objectmap import ObjectMap
    from slgaussian.language.rules import Rules
    from slgaussian.language.scoring import BankReader
    from slgaussian.language.vocabulary import load_vocabulary

    encoder = load_encoder("lexicon")
    rng = np.random.default_rng(0)
    words = [word for word, entry in load_vocabulary().words.items() if entry.weights]
    colours = ("red", "blue", "white", "green", "dark", "wooden", "small")
    texts = [f"{colours[k // len(words) % 7]} {words[k % len(words)]}" for k in range(count)]
    looks = rng.normal(size=(objects, 2, encoder.width)).astype(np.float32)
    looks /= np.linalg.norm(looks, axis=2, keepdims=True)
    bank = MemoryBank(
        np.arange(1, objects + 1, dtype=np.int32),
        rng.random((objects, 3)).astype(np.float32),
        looks,
        np.ones((objects, 2), bool),
    )
    cells = rng.integers(0, objects + 1, (52, 72)).astype(np.int32)
    ids = cells.repeat(8, 0).repeat(8, 1)
    rules = Rules()

    def new_view() -> object:
        reader = BankReader(bank, encoder)
        object_map = ObjectMap(ids, bank.ids)
        return [
            (hit.mask, hit.relevancy, hit.point) for hit in ask(texts, object_map, reader, rules)
        ]

    object_map = ObjectMap(ids, bank.ids)

    def old_view() -> object:
        reader = BankReader(bank, encoder)
        return [(hit.mask, hit.point) for hit in ask(texts, object_map, reader, rules)]

    return new_view, old_view


def _texts(size: float) -> Callable[[], object]:
    return _queries(60, int(size))[1]


def _objects(size: float) -> Callable[[], object]:
    return _queries(int(size), 1)[0]


def _gaussians(size: float) -> Callable[[], object]:
    from slgaussian.gaussians import Gaussians
    from slgaussian.rasterize.picture import picture
    from slgaussian.scene import Camera

    n, rng = int(size), np.random.default_rng(0)
    camera = Camera(np.array([[500.0, 0, 288], [0, 500, 208], [0, 0, 1]]), np.eye(4), 576, 416)
    depth = rng.uniform(2, 3, n)
    pixels = rng.uniform(0, (576, 416), (n, 2))
    means = np.concatenate([(pixels - (288, 208)) / 500, np.ones((n, 1))], 1) * depth[:, None]
    # Scale the Gaussians so that they cover each pixel about equally often for every n.
    wide = 0.4 * depth / 500 * np.sqrt(576 * 416 * 2 / n)
    gaussians = Gaussians.from_arrays(
        {
            "means": means.astype(np.float32),
            "scales": np.stack([wide, wide, wide / 10], 1).astype(np.float32),
            "quats": np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
            "opacities": np.full(n, 0.6, np.float32),
            "sh": np.zeros((n, 1, 3), np.float32),
            "source": np.arange(n, dtype=np.int32),
        }
    )
    values = rng.random((n, 6)).astype(np.float32)
    return lambda: picture(gaussians, values, camera)


def _field(views: int, megapixels: float) -> Callable[[], object]:
    from slgaussian import build_field, datasets

    height = round((megapixels * 1e6 * 3 / 4) ** 0.5 / 4) * 4
    size = height, round(height * 4 / 3 / 4) * 4
    scene = datasets.load("procedural", seed=3, views=views, height=size[0], width=size[1])
    sample = scene.sample(list(scene.cameras), [], size)
    return lambda: build_field(sample)


def point(axis: str, size: float) -> dict[str, float]:
    """Measure the cost of one size in this process: CPU ``seconds``, and ``megabytes``."""
    job(axis, RANGES[axis][0])()
    work = job(axis, size)
    spent: list[float] = []
    give_back()
    baseline = memory_status("VmRSS")
    reset_peak_memory()
    while not spent or (len(spent) < TIMES and spent[0] < SHORT):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    increase = max(memory_status("VmHWM") - baseline, 0)
    return {"size": size, "seconds": float(np.median(spent)), "megabytes": increase / 1e6}


def grown(axis: str) -> dict[str, object]:
    """Measure all sizes of a range, each in a separate process, as a row with exponents."""
    points = []
    for size in RANGES[axis]:
        command = [sys.executable, "-m", "benches.pipeline.cost_growth", "--point", axis, str(size)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(done.stderr)
        points.append(json.loads(done.stdout.splitlines()[-1]))
        print(axis, points[-1], file=sys.stderr)
    sizes = [point["size"] for point in points]
    row = {name: exponent(sizes, [p[name] for p in points]) for name in ("seconds", "megabytes")}
    costs = (f"{p['size']:,.10g}: {p['seconds']:.2g} s, {p['megabytes']:,.0f} MB" for p in points)
    return {"what": axis, "says": SAYS[axis], "costs": "; ".join(costs), **row}


COLUMNS = {
    "what": ("against", str),
    "says": ("what is done", str),
    "costs": ("size: CPU s, memory", str),
    "seconds": ("exponent of seconds", ".2f"),
    "megabytes": ("of memory", ".2f"),
}


def main() -> None:
    arguments = parser(__doc__, "scale.md")
    arguments.add_argument("--only", nargs="*", choices=RANGES, default=list(RANGES))
    arguments.add_argument("--point", nargs=2, help="used by itself")
    args = arguments.parse_args()
    if args.point:
        print(json.dumps(point(args.point[0], float(args.point[1]))))
        return
    rows = table([grown(axis) for axis in args.only], COLUMNS)
    publish(args.out, "scale.md", "python -m benches.pipeline.cost_growth", rows)


if __name__ == "__main__":
    main()
