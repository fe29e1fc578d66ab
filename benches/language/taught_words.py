"""Words taught by clicks against words known, in the same field and in others of the place.

    python -m benches.language.taught_words DATA [--fields DIR] [--page docs/measured/taught.md]

DATA holds ``office`` and ``places``, pairs of photographs with labelled targets. A field of each
pair is built once, and kept in DIR if it is given.

Each label of a target is taught to its field by clicks on innermost points: first of the label,
then of what is missed. Clicks are made in a context view, where it shows the surface. Then the word
is asked at the target, and at the targets of other pairs of the place that have the same label.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from unittest import mock

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder, load_samples
from slgaussian.benchmark.annotations import read_labels
from slgaussian.build import build_field
from slgaussian.errors import InputError
from slgaussian.field import FieldView, SemanticField
from slgaussian.language import taught
from slgaussian.language.locate import central_point
from slgaussian.language.query import QueryResult
from slgaussian.scene import Camera

CLICKS = 3
"""Clicks at most."""

CLOSE = 0.05
"""Relative depth within which a context view shows the surface that the target view shows."""

FEWEST = 30
"""Pixels of a label that are worth a click."""

WHERE = ("same field", "another pair")

TRIED = (0.2, 0.3, 0.4, 0.45, 0.5, 0.6, 0.7)
"""Values of :data:`slgaussian.language.taught.EVEN`."""

NEAR = 0.05
"""IoU that may be lost for words that find nothing where their thing is not."""

Row = dict[str, object]


@dataclass(frozen=True, eq=False)
class Labelled:
    """A field of a pair, its labelled target, and what is labelled there: bool [H, W] a word."""

    place: str
    scene: str
    field: SemanticField
    target: FieldView
    contexts: list[FieldView]
    masks: dict[str, np.ndarray]
    camera: Camera
    photograph: np.ndarray

    @cached_property
    def under(self) -> np.ndarray:
        """The object under a click in a context view, for each pixel of the target: int [H, W].

        The pixel is carried to the first context view that shows its surface, by its depth; where
        none does, it is clicked in the target.
        """
        ids = self.target.ids.copy()
        carried = self.target.depth <= 0
        points = self.camera.unproject(self.target.depth)
        for camera, seen in zip(self.field.cameras.values(), self.contexts, strict=True):
            pixels, z = camera.project(points)
            inside = (z > 0) & (pixels >= 0).all(-1) & (pixels < seen.ids.shape[::-1]).all(-1)
            u, v = np.where(inside[..., None], pixels, 0).astype(int).transpose(2, 0, 1)
            shown = inside & (np.abs(seen.depth[v, u] - z) <= CLOSE * z) & (seen.ids[v, u] > 0)
            ids = np.where(shown & ~carried, seen.ids[v, u], ids)
            carried |= shown
        return ids

    def asked(self, word: str, words: taught.TaughtWords | None = None) -> QueryResult | None:
        """What a word finds in the target, by the field's encoder or as taught; None if refused."""
        field = self.field if words is None else self.field.changed(taught=words)
        try:
            found: QueryResult = replace(self.target, field=field).query(word)
        except InputError:
            return None
        return found


def labelled(data: Path, kept: Path) -> Iterator[Labelled]:
    """Every labelled pair of ``office`` and ``places``."""
    known = sorted((data / "places").glob("*/pairs.json"))
    folders = {"office": data / "office"} | {file.parent.name: file.parent for file in known}
    for place, folder in folders.items():
        for scene, sample in load_samples(folder).items():
            path = kept / f"{place}-{scene}"
            if not path.exists():
                build_field(sample).save(path)
            field = SemanticField.load(path)
            (target,) = sample.targets
            camera = target.camera
            found = read_labels(folder / "labels", target.name, camera.width, camera.height)
            masks = {word: mask for word, mask in found.items() if mask.sum() >= FEWEST}
            contexts = [field.render(one) for one in field.cameras.values()]
            seen = field.render(camera)
            yield Labelled(
                place, scene, field, seen, contexts, masks, camera, np.asarray(target.image)
            )


def scored(hit: QueryResult | None, mask: np.ndarray) -> Row:
    """IoU with a mask, and whether the point is in it; 0 for a text that is refused."""
    if hit is None:
        return {"iou": 0.0, "point": 0.0}
    x, y = hit.point or (0, 0)
    iou = (hit.mask & mask).sum() / (hit.mask | mask).sum()
    return {"iou": float(iou), "point": float(hit.point is not None and bool(mask[y, x]))}


def lessons(one: Labelled, word: str, clicks: int = CLICKS) -> Iterator[taught.TaughtWords]:
    """Words taught of a label after each click."""
    mask, field = one.masks[word], one.field
    todo: np.ndarray | None = mask
    for _ in range(clicks):
        if todo is not None:
            x, y = central_point(todo)
            if id_ := int(one.under[y, x]):
                field = field.teach(word, id_)
        yield field.taught
        hit = one.asked(word, field.taught) if word in field.taught else None
        missed = mask if hit is None else mask & ~hit.mask
        todo = missed if missed.sum() >= FEWEST else None


def taught_rows(held: Sequence[Labelled], clicks: int = CLICKS) -> list[Row]:
    """Scores of every label after every click, at its own target and at others of the place."""
    rows = []
    for one in held:
        for word in one.masks:
            for click, words in enumerate(lessons(one, word, clicks), 1):
                for other in held:
                    if other.place != one.place or word not in other.masks:
                        continue
                    where = "same field" if other is one else "another pair"
                    hit = other.asked(word, words) if word in words else None
                    row = {"place": one.place, "scene": one.scene, "word": word, "clicks": click}
                    row |= {"where": where, "asked": other.scene}
                    rows.append(row | scored(hit, other.masks[word]))
    return rows


def picture_rows(held: Sequence[Labelled]) -> list[Row]:
    """Scores of asking for each label by its rectangle of the photograph of the target."""
    rows = []
    for one in held:
        for word, mask in one.masks.items():
            across, down = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
            crop = one.photograph[down[0] : down[-1] + 1, across[0] : across[-1] + 1]
            hit = one.target.like(np.ascontiguousarray(crop))
            row = {
                "place": one.place,
                "scene": one.scene,
                "word": word,
                "found": float(bool(hit.objects)),
            }
            rows.append(row | scored(hit, mask))
    return rows


def known_rows(held: Sequence[Labelled], rows: Sequence[Row]) -> list[Row]:
    """Scores of the labels as texts, of every answer of one click in ``rows``."""
    by_scene = {(one.place, one.scene): one for one in held}
    known = []
    for row in rows:
        if row["clicks"] == 1:
            one = by_scene[row["place"], row["asked"]]
            found = scored(one.asked(row["word"]), one.masks[row["word"]])
            known.append({**row, **found, "clicks": 0})
    return known


def absent(held: Sequence[Labelled]) -> list[Row]:
    """Whether words find something in targets of other places, where their things are not."""
    rows = []
    for one in held:
        for word in one.masks:
            words = next(lessons(one, word, clicks=1))
            for other in held:
                there = {w for near in held if near.place == other.place for w in near.masks}
                if word in there or word not in words:
                    continue
                for kind, hit in (
                    ("taught", other.asked(word, words)),
                    ("known", other.asked(word)),
                ):
                    refused = hit is None
                    found = hit is not None and bool(hit.objects)
                    rows.append(
                        {"place": one.place, "kind": kind, "refused": refused, "found": found}
                    )
    return rows


def by_place(rows: Sequence[Row], score: str) -> dict[str, float]:
    """Means by place: over the targets of a word first, then over its words."""
    words: dict[tuple, list[float]] = {}
    for row in rows:
        words.setdefault((row["place"], row["scene"], row["word"]), []).append(row[score])
    places: dict[str, list[float]] = {}
    for (place, _, _), scores in words.items():
        places.setdefault(place, []).append(float(np.mean(scores)))
    return {place: float(np.mean(means)) for place, means in places.items()}


def summary(rows: Sequence[Row], where: str) -> list[Row]:
    """A line a number of clicks: means over the office, over other places, and their spread."""
    lines = []
    for click in range(CLICKS + 1):
        own = [row for row in rows if (row["where"], row["clicks"]) == (where, click)]
        if not own:
            continue
        line: Row = {"clicks": "words" if click == 0 else str(click)}
        for score in ("iou", "point"):
            means = by_place(own, score)
            others = [mean for place, mean in means.items() if place != "office"]
            line[f"{score}_office"] = means["office"]
            line[f"{score}_places"] = float(np.mean(others))
            line[f"{score}_spread"] = float(np.std(others, ddof=1)) if len(others) > 1 else 0.0
        lines.append(line)
    return lines


def left_out(tried: dict[float, list[Row]]) -> list[Row]:
    """For each place: the value that the other places choose, and IoU at it and at the one in use.

    They choose the greatest value whose mean IoU of one click is within :data:`NEAR` of the best.
    """
    scores = {
        value: {
            where: by_place([row for row in rows if row["where"] == where], "iou")
            for where in ("same field", "another pair")
        }
        for value, rows in tried.items()
    }
    lines = []
    for place in scores[taught.EVEN]["same field"]:
        means = {
            value: np.mean(
                [
                    np.mean([mean for other, mean in own.items() if other != place])
                    for own in by_where.values()
                ]
            )
            for value, by_where in scores.items()
        }
        chosen = max(v for v, mean in means.items() if mean >= max(means.values()) - NEAR)
        line: Row = {"place": place, "chosen": chosen}
        for name, value in (("at", chosen), ("used", taught.EVEN)):
            for where, key in (("same field", "own"), ("another pair", "other")):
                if place in scores[value][where]:
                    line[f"{name}_{key}"] = scores[value][where][place]
        lines.append(line)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=data_folder("office/labels", "places"))
    parser.add_argument("--fields", type=Path)
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        held = list(labelled(given.data, given.fields or Path(folder)))
    rows = taught_rows(held)
    rows += known_rows(held, rows)
    strange = absent(held)
    tried, refused = {}, []
    for value in TRIED:
        with mock.patch.object(taught, "EVEN", value):
            tried[value] = taught_rows(held, clicks=1)
            found = [row["found"] for row in absent(held) if row["kind"] == "taught"]
            own = {where: [r for r in tried[value] if r["where"] == where] for where in WHERE}
            means = {where: list(by_place(r, "iou").values()) for where, r in own.items()}
            refused.append(
                {"even": value, "nothing": 1 - np.mean(found)}
                | {f"iou_{where.split()[0]}": float(np.mean(m)) for where, m in means.items()}
            )
    publish(
        "language/taught.md.j2",
        given.page,
        even=taught.EVEN,
        counts={
            "words": len({(r["place"], r["scene"], r["word"]) for r in rows}),
            "pairs": len(held),
            "others": sum(r["where"] == "another pair" and r["clicks"] == 1 for r in rows),
        },
        summaries={where: summary(rows, where) for where in WHERE},
        places=place_table(rows),
        strange={
            kind: {
                "asked": sum(row["kind"] == kind for row in strange),
                "nothing": 1 - np.mean([row["found"] for row in strange if row["kind"] == kind]),
                "refused": np.mean([row["refused"] for row in strange if row["kind"] == kind]),
            }
            for kind in ("taught", "known")
        },
        pictures=of_pictures(picture_rows(held)),
        tried=refused,
        left_out=left_out(tried),
    )


def of_pictures(rows: Sequence[Row]) -> list[Row]:
    """Means of asking by picture, over the office and over the other places."""
    means = {score: by_place(rows, score) for score in ("iou", "point", "found")}
    lines = []
    for name, of in (("office", True), ("places", False)):
        line: Row = {"set": name}
        for score, found in means.items():
            line[score] = np.mean([m for place, m in found.items() if (place == "office") == of])
        lines.append(line)
    return lines


def place_table(rows: Sequence[Row]) -> list[Row]:
    """IoU by place: of words, and of taught ones by clicks."""
    lines: dict[str, Row] = {}
    for where in WHERE:
        for click in range(CLICKS + 1):
            own = [row for row in rows if (row["where"], row["clicks"]) == (where, click)]
            for place, mean in by_place(own, "iou").items():
                line = lines.setdefault(place, {"place": place})
                line[f"{where.split()[0]}_{click}"] = mean
    return list(lines.values())


if __name__ == "__main__":
    main()
