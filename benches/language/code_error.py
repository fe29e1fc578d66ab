"""ID codes: label error against time.

``python -m benches.language.code_error -o docs/measured/codes.md [--data DIR]``

Writes the page and, beside it, its picture. DATA is a folder with ``transforms.json``,
``pairs.json`` (scene -> context and target views) and LERF-OVS labels of the targets in
``labels/``. ``--rooms N`` takes that many rooms for each number of objects.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.stats import rankdata

from benches.common.pages import publish
from benches.common.paired_timing import paired_times
from benches.common.photograph_pairs import DATA_HELP, labelled, load_samples
from benches.language.code_chart import picture as chart
from benches.language.many_object_rooms import SIZE, Room, make_rooms
from slgaussian.benchmark.annotations import read_labels
from slgaussian.build import label_views
from slgaussian.components.method import Method
from slgaussian.geometry import SceneGeometry
from slgaussian.kernels import threads
from slgaussian.language import load_codes
from slgaussian.language.codes import Separated
from slgaussian.language.nearest import nearest_code
from slgaussian.language.separated import misread, neighbours
from slgaussian.predict import load_predictor
from slgaussian.rasterize import Render, rasterize
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE, Decoder, elected_ids

COUNTS = (5, 20, 60, 200)
FIRST_SEED = 300
TIMED = 60
METHODS = {
    "exact": ("exact", {}),
    **{
        f"{name}, {dimension}": (name, {"dimension": dimension})
        for name in ("grid", "separated")
        for dimension in (3, 2, 1)
    },
}
ABSENT = 0.05
"""An object with at most this share of a pixel's light is a third one there."""
AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class Codes:
    """What a decoder needs of a bank."""

    ids: np.ndarray
    codes: np.ndarray

    def __len__(self) -> int:
        return len(self.ids)


def carried(room: Room, rows: torch.Tensor, codes: np.ndarray) -> dict[str, torch.Tensor]:
    """What is drawn: colours and codes; or, without codes, colours and labels."""
    colours = room.gaussians.colors()
    if codes.shape[1] == 0:
        return {"values": colours, "labels": rows}
    known = np.concatenate([codes, np.ones((len(codes), 1), np.float32)], 1)
    table = torch.from_numpy(np.concatenate([np.zeros_like(known[:1]), known]))
    return {"values": torch.cat([colours, table[rows]], 1)}


def draw(room: Room, rows: torch.Tensor, codes: np.ndarray, camera: Camera) -> Render:
    return rasterize(room.gaussians, camera=camera, **carried(room, rows, codes))


def decode(image: Render, bank: Codes) -> tuple[np.ndarray, np.ndarray]:
    if bank.codes.shape[1] == 0:
        return _elected(image, bank)
    return Decoder(bank)(image.values.numpy()[..., 3:])


def _elected(image: Render, bank: Codes) -> tuple[np.ndarray, np.ndarray]:
    assert image.label is not None and image.label_weights is not None  # drawn with labels
    return elected_ids(image.label.numpy(), image.label_weights.numpy(), bank.ids)


def nearest_only(image: Render, bank: Codes) -> np.ndarray:
    """As the paper says, without a look at other pixels."""
    features = image.values.numpy()[..., 3:]
    weight = features[..., -1]
    visible = weight >= VISIBLE
    ids = np.zeros(visible.shape, np.int32)
    values = features[visible, :-1] / weight[visible, None]
    ids[visible] = bank.ids[nearest_code(values, bank.codes)]
    return ids


def compare_all(image: Render, bank: Codes) -> np.ndarray:
    """The same, by comparing with every code in float64, a row of pixels at a time."""
    features = image.values.numpy()[..., 3:]
    ids = np.zeros(features.shape[:2], np.int32)
    codes = bank.codes.astype(np.float64)
    for row, out in zip(features, ids, strict=True):
        visible = row[:, -1] >= VISIBLE
        values = (row[visible, :-1] / row[visible, -1:]).astype(np.float64)
        far = sum(np.abs(values[:, k, None] - codes[:, k]) for k in range(codes.shape[1]))
        out[visible] = bank.ids[far.argmin(1)]
    return ids


def light(room: Room, rows: torch.Tensor, camera: Camera) -> np.ndarray:
    """Share of each object in the light of each pixel: float32 [H, W, N + 1], none first."""
    n = len(room.label_maps.ids)
    found = np.zeros((camera.height, camera.width, n + 1), np.float32)
    for first in range(1, n + 1, AT_ONCE):
        names = torch.arange(first, min(first + AT_ONCE, n + 1))
        drawn = rasterize(room.gaussians, (rows[:, None] == names).float(), camera)
        found[..., first : first + len(names)] = drawn.values.numpy()
    return found / np.maximum(found.sum(-1, keepdims=True), 1e-9)


def separation(doubt: np.ndarray, wrong: np.ndarray) -> float:
    """Probability that a wrong pixel has more doubt than a right one (area under the ROC)."""
    ranks, many = rankdata(doubt), int(wrong.sum())
    rest = wrong.size - many
    return float((ranks[wrong].sum() - many * (many + 1) / 2) / (many * rest)) if many else 1.0


def judge(
    truth: np.ndarray,
    found: np.ndarray,
    sure: np.ndarray,
    plain: np.ndarray,
    exact: np.ndarray,
    shares: np.ndarray,
    ids: np.ndarray,
) -> dict[str, float]:
    """The columns of one view."""
    wrong = found != truth
    seen = found > 0
    rows = np.where(found > 0, np.searchsorted(ids, found) + 1, 0)
    has = np.take_along_axis(shares, rows[..., None], -1)[..., 0]
    plain_rows = np.where(plain > 0, np.searchsorted(ids, plain) + 1, 0)
    plain_has = np.take_along_axis(shares, plain_rows[..., None], -1)[..., 0]
    least_sure = sure < np.quantile(sure, 0.1)
    return {
        "wrong": wrong.mean(),
        "added": wrong.mean() - (exact != truth).mean(),
        "differ": (found != exact).mean(),
        "third": (seen & wrong & (has <= ABSENT)).mean(),
        "plain": (plain != truth).mean(),
        "plain_third": ((plain > 0) & (plain != truth) & (plain_has <= ABSENT)).mean(),
        "auc": separation(-sure[seen], wrong[seen]),
        "doubted": (wrong & least_sure & seen).sum() / max((wrong & seen).sum(), 1),
    }


def error_rows(rooms: dict[int, list[Room]]) -> tuple[list[dict], list[dict]]:
    """A row a count and method; and a row a count of what ``auto`` takes."""
    rows, autos = [], []
    for some in rooms.values():
        found: dict[str, list[dict]] = {name: [] for name in METHODS}
        dimensions, read, seconds = [], [], []
        for room in some:
            labels, objects = room.rows, room.label_maps.ids
            banks = {}
            for name, (strategy, own) in METHODS.items():
                made = load_codes(strategy, **own)(room.label_maps, np.random.default_rng(0))
                banks[name] = Codes(objects, made)
            start = time.process_time()
            taken = Separated(dimension="auto")(room.label_maps, np.random.default_rng(0))
            seconds.append(time.process_time() - start)
            dimensions.append(taken.shape[1])
            read.append(misread(taken, neighbours(room.label_maps)))
            for camera, truth in zip(room.cameras, room.truths, strict=True):
                shares = light(room, labels, camera)
                exact = None
                for name, bank in banks.items():
                    image = draw(room, labels, bank.codes, camera)
                    ids, sure = decode(image, bank)
                    exact = ids if exact is None else exact
                    plain = nearest_only(image, bank) if bank.codes.shape[1] else ids
                    if bank.codes.shape[1] and (plain != compare_all(image, bank)).any():
                        raise AssertionError(f"{room.name}, {name}: not the nearest code")
                    found[name].append(judge(truth, ids, sure, plain, exact, shares, objects))
        n = np.mean([len(room.label_maps.ids) for room in some])
        for name, views in found.items():
            means = {key: float(np.mean([view[key] for view in views])) for key in views[0]}
            rows.append({"objects": n, "method": name} | means)
            print(rows[-1], flush=True)
        autos.append(
            {
                "objects": n,
                "dimension": float(np.mean(dimensions)),
                "misread": float(np.mean(read)),
                "seconds": float(np.median(seconds)),
            }
        )
    return rows, autos


def time_rows(room: Room) -> list[dict]:
    """Seconds of a core to draw a view of ``room``, and to read it, by method; timed in turn."""
    threads.limit(threads.cores())
    labels, camera = room.rows, room.cameras[0]
    drawing: dict[str, Callable[[], object]] = {
        "colours alone": lambda: rasterize(room.gaussians, room.gaussians.colors(), camera)
    }
    reading: dict[str, Callable[[], object]] = {}
    for name, (strategy, own) in METHODS.items():
        made = load_codes(strategy, **own)(room.label_maps, np.random.default_rng(0))
        bank = Codes(room.label_maps.ids, made)
        what = carried(room, labels, made)
        drawing[name] = lambda w=what: rasterize(room.gaussians, camera=camera, **w)
        image = drawing[name]()
        if made.shape[1] == 0:
            reading[f"read {name}"] = lambda image=image, bank=bank: _elected(image, bank)
            continue
        decoder, features = Decoder(bank), image.values.numpy()[..., 3:]
        reading[f"read {name}"] = lambda d=decoder, f=features: d(f)
        reading[f"all {name}"] = lambda image=image, bank=bank: compare_all(image, bank)
        reading[f"table {name}"] = lambda bank=bank: Decoder(bank)
    drew, read = paired_times(drawing, time.thread_time), paired_times(reading, time.thread_time)
    threads.limit()
    rows = [{"method": "colours alone", "draw": drew["colours alone"]}]
    for name in METHODS:
        row = {"method": name, "draw": drew[name], "read": read[f"read {name}"]}
        row["both"] = row["draw"] + row["read"]
        if f"all {name}" in read:
            row |= {"all": read[f"all {name}"], "table": read[f"table {name}"]}
            row["ratio"] = row["all"] / row["read"]
        rows.append(row)
    return rows


def placing_rows(rooms: dict[int, list[Room]]) -> list[dict]:
    """How well and how fast ``separated`` places codes: 3 dimensions."""
    rows = []
    for some in rooms.values():
        maps = some[0].label_maps
        pairs = neighbours(maps)
        codes = {}
        for name in ("grid", "separated"):
            start = time.process_time()
            codes[name] = load_codes(name)(maps, np.random.default_rng(0))
            seconds = time.process_time() - start
        rows.append(
            {
                "objects": len(maps.ids),
                "pairs": len(pairs.weights),
                "grid": misread(codes["grid"], pairs),
                "separated": misread(codes["separated"], pairs),
                "seconds": seconds,
            }
        )
    return rows


def office_rows(folder: Path) -> list[dict]:
    """The pairs of a folder with labels found in the photographs; truth is what was drawn by hand.

    An object stands for the category that most of its labelled pixels have, read exactly.
    """
    found: dict[str, list[dict]] = {name: [] for name in METHODS}
    default, counts = Method(), []
    for name, sample in load_samples(folder).items():
        gaussians = load_predictor("planesweep")(sample)
        seen = SceneGeometry.of(sample.context, gaussians)
        maps = label_views(seen, default.proposer, default.tracker, default.replicas)
        target = sample.targets[0]
        room = Room(name, gaussians, maps, [target.camera], [])
        labels = room.rows
        counts.append(len(maps.ids))
        masks = read_labels(folder / "labels", Path(target.name).stem, SIZE[1], SIZE[0])
        drawn = np.zeros(SIZE, np.int32)
        for number, mask in enumerate(masks.values(), 1):
            drawn[mask] = number
        exact = means = None
        for method, (strategy, own) in METHODS.items():
            made = load_codes(strategy, **own)(maps, np.random.default_rng(0))
            bank = Codes(maps.ids, made)
            image = draw(room, labels, made, target.camera)
            ids, _ = decode(image, bank)
            if exact is None:
                exact = ids
                counted = np.zeros((int(maps.ids.max()) + 1, len(masks) + 1), int)
                np.add.at(counted, (ids[drawn > 0], drawn[drawn > 0]), 1)
                means = counted.argmax(1)
            plain = nearest_only(image, bank) if made.shape[1] else ids
            told = drawn > 0
            found[method].append(
                {
                    "differ": (ids != exact).mean(),
                    "plain_differ": (plain != exact).mean(),
                    "wrong": (means[ids] != drawn)[told].mean(),
                    "plain_wrong": (means[plain] != drawn)[told].mean(),
                }
            )
        print(name, counts[-1], flush=True)
    rows = []
    for method, views in found.items():
        means = {key: float(np.mean([view[key] for view in views])) for key in views[0]}
        rows.append({"method": method, "objects": float(np.mean(counts))} | means)
    return rows


def crops(room: Room) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Ids of a part of a novel view by some methods, and which of them are wrong."""
    labels, camera, truth = room.rows, room.cameras[0], room.truths[0]
    shown = {"truth": (truth, np.zeros_like(truth, bool))}
    for name in ("grid, 3", "separated, 3", "exact"):
        strategy, own = METHODS[name]
        made = load_codes(strategy, **own)(room.label_maps, np.random.default_rng(0))
        bank = Codes(room.label_maps.ids, made)
        image = draw(room, labels, made, camera)
        if name == "grid, 3":
            plain = nearest_only(image, bank)
            shown[f"{name}: nearest code alone"] = plain, plain != truth
        ids, _ = decode(image, bank)
        shown[name] = ids, ids != truth
    return shown


def run(out: Path, rooms: int, data: Path | None, command: str) -> None:
    made: dict[int, list[Room]] = {count: [] for count in COUNTS}
    for seed in range(FIRST_SEED, FIRST_SEED + rooms):
        for count, room in zip(COUNTS, make_rooms(seed, COUNTS), strict=True):
            made[count].append(room)
        print(f"room {seed}", flush=True)
    tables = {"times": time_rows(made[TIMED][0]), "placing": placing_rows(made)}
    tables["errors"], tables["auto"] = error_rows(made)
    if data is not None:
        tables["office"] = office_rows(data)
    picture = out.with_suffix(".png")
    publish(
        "language/codes.md.j2",
        out,
        rows=tables,
        rooms=rooms,
        command=command,
        picture=picture.name,
    )
    picture.write_bytes(chart(tables["errors"], tables["times"], crops(made[TIMED][0])))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/measured/codes.md"))
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--data", type=labelled, help=DATA_HELP)
    given = parser.parse_args()
    threads.limit()
    command = f"python -m benches.language.code_error --rooms {given.rooms}" + (
        " --data DATA" * bool(given.data)
    )
    run(given.out, given.rooms, given.data, command)
