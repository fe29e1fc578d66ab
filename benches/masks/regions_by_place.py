"""Regions against true masks, by place.

    python -m benches.masks.regions_by_place DATA [-o docs/measured]

DATA holds ``office`` and ``places``. Of every target photograph with labels, and of one view of
each of 20 made-up rooms: the best region of one partition, the best union of its regions, and the
best of the masks of all levels. Next to ours stand the partitions of ``other_regions.py``, in the
same run.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benches.common.pages import publish
from benches.common.photograph_pairs import SIZE, data_folder, read_pairs
from benches.masks.other_regions import METHODS
from benches.masks.proposal_fit import best_mask, predicted_depth
from benches.masks.regions_picture import outlined, painted, sheet
from slgaussian.benchmark.annotations import read_labels
from slgaussian.datasets import nerfstudio
from slgaussian.datasets.procedural import reader
from slgaussian.geometry import SeenView
from slgaussian.masks.flatten import flatten
from slgaussian.masks.regions import Regions
from slgaussian.scene import View

PLACES = ("bonsai", "castle", "dining", "kitchen", "lounge", "street")
ROOMS = range(40, 60)
LEAST = 60
"""Fewest pixels of a true mask that counts."""
WHITE = 85.0
LIGHTEST = 0.02
"""CIELAB lightness to which this share of a dark photograph is brought."""
FREE = ("office", "street")
"""Whose photographs may be shown: MIT and BSD licences. Of the others only the regions are."""
SHOWN_OF_OFFICE = ("hall_sofa", "fruit_table", "coffee_machine", "sofa_plant")
QUALITIES = ("union", "single", "any")
WHERE = ("office", "places", "rooms")
FEW = 100
"""A setting of another method is compared with ours if it makes at most so many regions."""


@dataclass(frozen=True, eq=False)
class Labelled:
    """A photograph with true masks; ``depth`` is predicted from it and a neighbour."""

    place: str
    scene: str
    image: np.ndarray
    depth: np.ndarray
    truths: Mapping[str, np.ndarray]


def photographs(data: Path) -> Iterator[Labelled]:
    for place in ("office", *PLACES):
        folder = data / place if place == "office" else data / "places" / place
        scenes = nerfstudio.read(folder)
        for name, (context, target) in read_pairs(folder / "pairs.json").items():
            view = at_most(scenes.read(scenes.find(target[0])))
            height, width = view.image.shape[:2]
            other = scenes.read(scenes.find(context[0])).resized(height, width)
            truths = read_labels(folder / "labels", Path(target[0]).stem, width, height)
            yield labelled(place, name, view, other, truths)


def rooms() -> Iterator[Labelled]:
    for seed in ROOMS:
        scene = reader.read(seed=seed, height=SIZE[0], width=SIZE[1])
        first, view = (scene.read(name) for name in list(scene.cameras)[:2])
        assert view.instances is not None
        truths = {str(i): view.instances == i for i in np.unique(view.instances) if i}
        yield labelled("rooms", f"room {seed}", view, first, truths)


def labelled(
    place: str, scene: str, view: View, other: View, truths: Mapping[str, np.ndarray]
) -> Labelled:
    large = {name: mask for name, mask in truths.items() if mask.sum() >= LEAST}
    return Labelled(place, scene, view.image, predicted_depth(view, other), large)


def at_most(view: View) -> View:
    """The view with at most as many pixels as a run works at."""
    height, width = view.image.shape[:2]
    scale = min(1.0, (SIZE[0] * SIZE[1] / (height * width)) ** 0.5)
    return view.resized(round(height * scale), round(width * scale))


def best_of_partition(labels: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """IoU of ``truth`` with the best union of regions, and with the best region.

    ``labels`` int [H, W] from 0. Taken by falling share of a region inside the truth, the best
    union is a beginning of that order.
    """
    inside = np.bincount(labels[truth], minlength=labels.max() + 1).astype(float)
    area = np.bincount(labels.ravel(), minlength=len(inside)).astype(float)
    order = np.argsort(-inside / np.maximum(area, 1))
    outside = np.cumsum((area - inside)[order])
    union = (np.cumsum(inside[order]) / (truth.sum() + outside)).max()
    return float(union), float((inside / (truth.sum() + area - inside)).max())


class WellExposed(View):
    """A photograph whose colours are those of a longer exposure, if it is dark.

    All of CIELAB grows by one factor, so that hues stay.
    """

    @cached_property
    def lab(self) -> np.ndarray:
        taken = View(self.name, self.camera, self.image).lab
        lightest = float(np.quantile(taken[..., 0], 1 - LIGHTEST))
        return taken * np.float32(max(WHITE / max(lightest, 10.0), 1.0))


BEFORE = "ours before: height .28, at most 60"
NOW = "ours now: height .20, at most 90"
OURS: dict[str, tuple[dict[str, Any], type[View], bool]] = {
    BEFORE: ({"height": 0.28, "most_objects": 60}, View, False),
    NOW: ({}, View, False),
    "ours now, with predicted depth": ({}, View, True),
    "ours now, dark photographs lit": ({}, WellExposed, False),
}
"""Settings of :class:`Regions`, what a photograph is to it, and whether it is given the depth."""


def look(photo: Labelled, kind: type[View], depth: bool) -> SeenView:
    view = SeenView.alone(photo.image).view
    return SeenView(kind(view.name, view.camera, view.image), photo.depth if depth else None)


def measure(photos: list[Labelled]) -> list[dict]:
    """A row for every method, setting and place, and one for all of ``places``."""
    rows = []
    for method, (settings, kind, depth) in OURS.items():
        cut, levels = Regions(**settings), Regions(level="all", **settings)
        looked = [look(photo, kind, depth) for photo in photos]
        met = [
            fit(photo, lambda view, cut=cut: flatten(cut.propose(view)), view)
            for photo, view in zip(photos, looked, strict=True)
        ]
        for one, photo, view in zip(met, photos, looked, strict=True):
            masks = levels.propose(view).masks
            one["any"] = [best_mask(masks, truth) for truth in photo.truths.values()]
        rows += by_place(photos, met, method=method, setting="")
        print(rows[-1], flush=True)
    for method, partitions in METHODS.items():
        of_method = {
            setting: [fit(photo, cut, photo.image) for photo in photos]
            for setting, cut in partitions.items()
        }
        for number in range(len(photos)):
            best = np.max([met[number]["single"] for met in of_method.values()], axis=0)
            for met in of_method.values():
                met[number]["any"] = list(best)
        for setting, met in of_method.items():
            rows += by_place(photos, met, method=method, setting=setting)
            print(rows[-1], flush=True)
    return rows


def fit(photo: Labelled, cut: Callable[[Any], np.ndarray], given: object) -> dict:
    """How well a partition of what is given meets each true mask of it, and what it took."""
    start = time.process_time()
    found = cut(given)
    seconds = time.process_time() - start
    labels = np.unique(found, return_inverse=True)[1].reshape(photo.image.shape[:2])
    best = [best_of_partition(labels, truth) for truth in photo.truths.values()]
    union, single = zip(*best, strict=True)
    return {"union": union, "single": single, "regions": labels.max() + 1, "seconds": seconds}


def by_place(photos: list[Labelled], met: list[dict], **what: str) -> list[dict]:
    rows = []
    for place in ("office", "places", *PLACES, "rooms"):
        names = PLACES if place == "places" else (place,)
        here = [one for one, photo in zip(met, photos, strict=True) if photo.place in names]
        row = {key: np.mean(np.concatenate([one[key] for one in here])) for key in QUALITIES}
        row |= {"regions": np.mean([one["regions"] for one in here])}
        row |= {"seconds": np.median([one["seconds"] for one in here])}
        rows.append({**what, "place": place, **row, "photographs": len(here)})
    return rows


def best_settings(rows: list[dict]) -> dict[str, str]:
    """Of every other method the setting with the largest sum of union and single, over office,
    places and rooms, among those that make at most FEW regions in each."""
    chosen = {}
    for method, partitions in METHODS.items():
        worth = {}
        for setting in partitions:
            here = [r for r in rows if r["method"] == method and r["setting"] == setting]
            here = [r for r in here if r["place"] in WHERE]
            if all(r["regions"] <= FEW for r in here):
                worth[setting] = sum(r["union"] + r["single"] for r in here)
        chosen[method] = max(worth, key=lambda setting: worth[setting])
    return chosen


def picture(photos: list[Labelled]) -> Image.Image:
    strips = []
    for photo in photos:
        if photo.place in PLACES or photo.scene in SHOWN_OF_OFFICE:
            strip = [outlined(photo.image, photo.truths)] if photo.place in FREE else []
            for settings, kind, depth in (OURS[BEFORE], OURS[NOW]):
                labels = flatten(Regions(**settings).propose(look(photo, kind, depth)))
                strip.append(painted(labels))
            strips.append(strip)
    return sheet(strips)


def pivots(rows: list[dict], chosen: Mapping[str, str]) -> dict[str, list[dict]]:
    """A table for every column of the rows: methods down, places across."""
    tables: dict[str, list[dict]] = {}
    for key in (*QUALITIES, "regions", "seconds"):
        for method in (*OURS, *METHODS):
            setting = chosen.get(method, "")
            here = [r for r in rows if r["method"] == method and r["setting"] == setting]
            line = {"method": method} | {row["place"]: row[key] for row in here}
            tables.setdefault(key, []).append(line)
    return tables


def all_settings(rows: list[dict]) -> list[dict]:
    """Union, single and regions of every setting of other methods."""
    lines: dict[tuple[str, str], dict] = {}
    for row in rows:
        if row["method"] in METHODS and row["place"] in WHERE:
            line = lines.setdefault((row["method"], row["setting"]), {})
            line |= {key: row[key] for key in ("method", "setting")}
            line[row["place"]] = f"{row['union']:.3f} / {row['single']:.3f} / {row['regions']:.0f}"
    return list(lines.values())


def results(rows: list[dict]) -> dict[str, Any]:
    """What the template of the page is given."""
    chosen = best_settings(rows)
    return {
        "pivots": pivots(rows, chosen),
        "settings": all_settings(rows),
        "chosen": chosen,
        "counts": {row["place"]: row["photographs"] for row in rows},
        "wheres": list(dict.fromkeys(row["place"] for row in rows)),
        "least": LEAST,
        "few": FEW,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    holds = data_folder("office/pairs.json", *(f"places/{place}/pairs.json" for place in PLACES))
    parser.add_argument("data", type=holds, help="folder that holds office and places")
    parser.add_argument("-o", "--out", type=Path, help="folder for regions.md and regions.jpg")
    given = parser.parse_args()
    photos = [*photographs(given.data), *rooms()]
    if given.out:
        picture(photos).save(given.out / "regions.jpg", quality=78)
    rows = measure(photos)
    file = given.out and given.out / "regions.md"
    publish("masks/regions.md.j2", file, **results(rows))


if __name__ == "__main__":
    main()
