"""Label error and time of strategies of ID codes, in made-up rooms with exact labels.

    python -m benches.language.code_error [-o docs/measured] [--rooms 4]

Context views have their true labels: the error of ``exact``, which needs no codes, is geometry's,
and what other strategies add to it comes from codes and decoding.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from benches.common.harness import ms, parser, publish, table, times_in_turn
from benches.language.many_object_rooms import Room, make_rooms
from slgaussian.kernels import threads
from slgaussian.language import load_codes
from slgaussian.language.nearest import nearest_code
from slgaussian.rasterize import Render, rasterize
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE, Decoder, elected_ids

COUNTS = (5, 20, 60, 200)
FIRST_SEED = 300
TIMED = 60
METHODS = {
    "exact": ("exact", {}),
    "grid, 3": ("grid", {"dimension": 3}),
    "separated, 3": ("separated", {"dimension": 3}),
    "separated, 2": ("separated", {"dimension": 2}),
    "separated, 1": ("separated", {"dimension": 1}),
}
"""Strategy and numbers of a code; the paper has ``grid, 3``."""


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


def codes_of(room: Room, method: str) -> Codes:
    strategy, options = METHODS[method]
    make = load_codes(strategy, **options)
    return Codes(room.label_maps.ids, make(room.label_maps, np.random.default_rng(0)))


def error_rows(count: int, rooms: list[Room]) -> list[dict]:
    """A row a method: shares of the pixels of novel views, means over rooms and views."""
    scores: dict[str, list[dict[str, float]]] = {name: [] for name in METHODS}
    for room in rooms:
        banks = {name: codes_of(room, name) for name in METHODS}
        for camera, truth in zip(room.cameras, room.truths, strict=True):
            exact = None
            for name, bank in banks.items():
                image = draw(room, room.rows, bank.codes, camera)
                ids, _ = decode(image, bank)
                exact = ids if exact is None else exact
                plain = nearest_only(image, bank) if bank.codes.shape[1] else ids
                wrong = float((ids != truth).mean())
                scores[name].append(
                    {
                        "wrong": wrong,
                        "added": wrong - float((exact != truth).mean()),
                        "differ": float((ids != exact).mean()),
                        "plain": float((plain != truth).mean()),
                    }
                )
    rows = []
    for name, views in scores.items():
        means = {key: float(np.mean([view[key] for view in views])) for key in views[0]}
        rows.append({"objects": count, "method": name} | means)
        print(rows[-1], flush=True)
    return rows


def time_rows(room: Room) -> dict[str, dict[str, float]]:
    """Seconds of a core to draw a view, and to read ids and confidence from it, by method."""
    threads.limit(threads.cores())
    camera = room.cameras[0]
    drawing: dict[str, Callable[[], object]] = {}
    reading: dict[str, Callable[[], object]] = {}
    for name in METHODS:
        bank = codes_of(room, name)
        drawing[name] = lambda bank=bank: draw(room, room.rows, bank.codes, camera)
        image = draw(room, room.rows, bank.codes, camera)
        if bank.codes.shape[1]:
            decoder, features = Decoder(bank), image.values.numpy()[..., 3:]
            reading[name] = lambda decoder=decoder, features=features: decoder(features)
        else:
            reading[name] = lambda bank=bank, image=image: _elected(image, bank)
    drew, read = (times_in_turn(jobs, time.thread_time) for jobs in (drawing, reading))
    threads.limit()
    return {name: {"draw": drew[name], "read": read[name]} for name in METHODS}


def per_cent(share: object) -> str:
    return f"{100 * share:.2f}"


COLUMNS = {
    "objects": ("objects", ".0f"),
    "method": ("codes, numbers", str),
    "wrong": ("wrong, %", per_cent),
    "added": ("added, %", per_cent),
    "differ": ("differ, %", per_cent),
    "plain": ("nearest alone: wrong, %", per_cent),
    "draw": ("draw, ms", ms),
    "read": ("read, ms", ms),
}


def main() -> None:
    arguments = parser(__doc__, "codes.md")
    arguments.add_argument("--rooms", type=int, default=4, help="rooms a number of objects")
    asked = arguments.parse_args()
    threads.limit()
    rooms: dict[int, list[Room]] = {count: [] for count in COUNTS}
    for seed in range(FIRST_SEED, FIRST_SEED + asked.rooms):
        for count, room in zip(COUNTS, make_rooms(seed, COUNTS), strict=True):
            rooms[count].append(room)
    times = time_rows(rooms[TIMED][0])
    rows = []
    for count, some in rooms.items():
        objects = round(np.mean([len(room.label_maps.ids) for room in some]))
        for row in error_rows(objects, some):
            rows.append(row | (times[row["method"]] if count == TIMED else {}))
    command = "python -m benches.language.code_error"
    publish(asked.out, "codes.md", command, table(rows, COLUMNS))


if __name__ == "__main__":
    main()
