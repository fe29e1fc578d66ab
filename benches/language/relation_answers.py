"""Questions of where things are, asked of made-up rooms that know the answer.

    python -m benches.language.relation_answers [-o docs/measured] [--rooms N] [--rows R]

In each room a field is built of the two ends of the arc, and asked at a view between them. Nouns
are shapes, of which a room has several: "ball left of the red box" is asked where some balls are
left of that box and others are not, and where none is. The truth comes from exact depths and ids
of all views, by rules of this file with margins: what people could dispute is not asked. Beside
each answer stands that of the bare noun, "ball". Rows are kept in FILE as they come, and rooms that
it holds are not done again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from benches.common.pages import publish
from slgaussian import datasets
from slgaussian.build import build_field
from slgaussian.datasets.procedural.names import SHAPES
from slgaussian.field import FieldView, SemanticField
from slgaussian.kernels import threads
from slgaussian.language.bank import MemoryBank
from slgaussian.language.named import Named
from slgaussian.language.query import QueryResult
from slgaussian.scene import Camera, Sample, Scene

HEIGHT, WIDTH = 240, 336
ABSENT = 20
"""Questions of a room about what is not there; of more, these many by chance."""

CONTEXT, TARGET = ("view_00", "view_03"), "view_01"
UP = np.array([0.0, 0.0, 1.0])
SHOWN = 0.002
"""Least share of the target view that a thing has to be asked for."""

RELATIONS = ("left of", "right of", "above", "below", "on", "next to", "behind", "in front of")
SUPERLATIVES = (
    "largest", "smallest", "nearest", "farthest", "highest", "lowest", "leftmost", "rightmost",
)  # fmt: skip


class Row(NamedTuple):
    """One question: its kind, whether anything is the answer, and who was right.

    ``point``: it is on a thing that is meant. ``mask``: its IoU with all that are meant
    is above 0.5. Where nothing is meant, both are right if nothing was found.
    """

    room: int
    words: str
    kind: str
    text: str
    there: bool
    mask: bool
    point: bool
    bare_mask: bool
    bare_point: bool


@dataclass(frozen=True, eq=False)
class Known:
    """A thing of a room: its name, and exact points of its surface as some view shows them."""

    id: int
    name: str
    points: np.ndarray
    shown: np.ndarray

    @property
    def noun(self) -> str:
        return self.name.split(" ")[-1]


def known(scene: Scene, target: Camera) -> list[Known]:
    """What the target view shows of a room."""
    points: dict[int, list[np.ndarray]] = {}
    for name, camera in scene.cameras.items():
        view = scene.read(name)
        where = camera.unproject(view.depth)
        for id_ in np.unique(view.instances):
            points.setdefault(int(id_), []).append(where[view.instances == id_])
    ids = scene.read(TARGET).instances
    return [
        Known(id_, scene.phrases[id_], np.concatenate(points[id_]), ids == id_)
        for id_ in sorted(points)
        if (ids == id_).mean() >= SHOWN
    ]


def interval(values: np.ndarray) -> tuple[float, float]:
    low, high = np.percentile(values, [2, 98])
    return float(low), float(high)


def before(a: np.ndarray, b: np.ndarray) -> bool | None:
    """Whether values ``a`` come before ``b``; None where that can be disputed."""
    (la, ha), (lb, hb) = interval(a), interval(b)
    shared = (min(ha, hb) - max(la, lb)) / min(ha - la, hb - lb)
    if shared > 0.35:
        return None if shared < 0.75 else False
    return la + ha < lb + hb


def both(first: bool | None, second: bool | None) -> bool | None:
    if first is False or second is False:
        return False
    return None if first is None or second is None else True


def meet(a: np.ndarray, b: np.ndarray) -> bool | None:
    """Whether two ranges of values overlap clearly."""
    (la, ha), (lb, hb) = interval(a), interval(b)
    shared = (min(ha, hb) - max(la, lb)) / min(ha - la, hb - lb)
    return True if shared > 0.25 else None if shared > -0.25 else False


def truly(relation: str, a: Known, b: Known, camera: Camera) -> bool | None:
    """Whether ``a`` lies so to ``b``; None where that can be disputed."""
    (pa, za), (pb, zb) = camera.project(a.points), camera.project(b.points)
    xa, xb, ha, hb = pa[:, 0], pb[:, 0], a.points @ UP, b.points @ UP
    if relation == "left of":
        return before(xa, xb)
    if relation == "right of":
        return before(xb, xa)
    if relation == "behind":
        return both(before(zb, za), meet(xa, xb))
    if relation == "in front of":
        return both(before(za, zb), meet(xa, xb))
    if relation == "above":
        return both(before(hb, ha), meet(xa, xb))
    if relation == "below":
        return both(before(ha, hb), meet(xa, xb))
    gap = float(cKDTree(b.points[::3]).query(a.points[::3])[0].min())
    if relation == "on":
        if gap > 0.06:
            return False
        foot = ha.min()
        flat = a.points[:, :2].mean(0)
        around = b.points[np.linalg.norm(b.points[:, :2] - flat, axis=1) < 0.35]
        return bool(len(around)) and bool(abs(around[:, 2].max() - foot) < 0.03)
    sizes = [np.linalg.norm(np.ptp(one.points, 0)) for one in (a, b)]
    near = gap / np.sqrt(sizes[0] * sizes[1])
    return True if near < 0.5 else None if near < 1 else False


def chosen(superlative: str, things: Sequence[Known], camera: Camera) -> Known | None:
    """Which of several things it is; None where that can be disputed."""
    depth = [float(np.median(camera.project(one.points)[1])) for one in things]
    column = [float(np.median(camera.project(one.points)[0][:, 0])) for one in things]
    middle = [float(np.mean(interval(one.points @ UP))) for one in things]
    size = [float(np.linalg.norm(np.ptp(one.points, 0))) for one in things]
    values, clear = {
        "largest": (size, 0.15 * max(size)),
        "smallest": (size, 0.15 * max(size)),
        "nearest": (depth, 0.15),
        "farthest": (depth, 0.15),
        "highest": (middle, 0.08),
        "lowest": (middle, 0.08),
        "leftmost": (column, 0.03 * camera.width),
        "rightmost": (column, 0.03 * camera.width),
    }[superlative]
    sign = -1 if superlative in ("largest", "farthest", "highest", "rightmost") else 1
    order = np.argsort(sign * np.array(values))
    if abs(values[order[0]] - values[order[1]]) < clear:
        return None
    return things[order[0]]


def questions(things: Sequence[Known], camera: Camera) -> Iterator[tuple[str, str, str, list]]:
    """Kind, text, bare noun and the things that are meant."""
    nouns: dict[str, list[Known]] = {}
    for one in things:
        if one.noun in SHAPES:
            nouns.setdefault(one.noun, []).append(one)
    for noun, several in nouns.items():
        for anchor in things:
            if anchor in several or anchor.noun in ("wall", "ceiling"):
                continue
            for relation in RELATIONS:
                if relation != "on" and anchor.noun in ("floor", "carpet"):
                    continue
                if relation == "on" and anchor.noun == "floor":
                    continue  # "on the floor" is a place of the lexicon
                told = [truly(relation, one, anchor, camera) for one in several]
                if None in told:
                    continue
                meant = [one for one, true in zip(several, told, strict=True) if true]
                if len(meant) < len(several) or relation == "on":
                    yield relation, f"{noun} {relation} the {anchor.name}", noun, meant
        if len(several) > 1:
            for superlative in SUPERLATIVES:
                one = chosen(superlative, several, camera)
                if one is not None:
                    yield superlative, f"{superlative} {noun}", noun, [one]
        yield "how many", f"how many {noun}s", noun, several


def judged(hit: QueryResult, meant: Sequence[Known]) -> tuple[bool, bool]:
    """Whether mask and point are right."""
    if not meant:
        return (not hit.objects,) * 2
    right = np.any([one.shown for one in meant], axis=0)
    union = (right | hit.mask).sum()
    on = bool(hit.objects) and hit.point is not None and bool(right[hit.point[1], hit.point[0]])
    return bool((right & hit.mask).sum() > 0.5 * union), on


def rows_of(seed: int) -> Iterator[Row]:
    """The questions of one room."""
    scene = datasets.load("procedural", seed=seed, height=HEIGHT, width=WIDTH)
    scene = replace(scene, read=cache(scene.read))
    sample = scene.sample(CONTEXT, [TARGET])
    target = sample.targets[0]
    things = known(scene, target.camera)
    field = build_field(sample)
    yield from asked(seed, "lexicon", field.render(target.camera), things, target.camera)
    told = told_names(field, sample, things)
    yield from asked(seed, "told", told.render(target.camera), things, target.camera)


def told_names(field: SemanticField, sample: Sample, things: Sequence[Known]) -> SemanticField:
    """The field whose words are right: each object has the true name of most of its pixels.

    What is wrong then lies in how photographs were cut up, and in geometry.
    """
    names = {one.id: one.name for one in things}
    counts = np.zeros((len(field.bank), 1 + max(names)), np.int64)
    for view in sample.context:
        assert view.instances is not None
        drawn = field.render(view.camera).ids
        both_ = (drawn > 0) & np.isin(view.instances, list(names))
        rows = np.searchsorted(field.bank.ids, drawn[both_])
        np.add.at(counts, (rows, view.instances[both_]), 1)
    words = sorted({word for name in names.values() for word in (name, name.split(" ")[-1])})
    axes = np.eye(len(words) + 1)
    vectors = {}
    for word in words:
        both_ = axes[words.index(word)] + axes[words.index(word.split(" ")[-1])]
        vector = both_ / np.linalg.norm(both_)
        vectors |= {word: vector, f"the {word}": vector, f"{word}s": vector}
    rows = [vectors[names[int(n.argmax())]] if n.any() else axes[-1] for n in counts]
    bank = field.bank
    features = np.where(bank.present[..., None], np.stack(rows)[:, None], 0).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "names.npz"
        np.savez(table, names=list(vectors), features=np.stack(list(vectors.values())))
        encoder = Named(table)
    told = field.changed(bank=MemoryBank(bank.ids, bank.codes, features, bank.present))
    told.__dict__["encoder"] = encoder
    return told


def asked(
    seed: int, words: str, view: FieldView, things: Sequence[Known], camera: Camera
) -> Iterator[Row]:
    bares: dict[str, QueryResult] = {}
    every = list(questions(things, camera))
    absent = [question for question in every if not question[3]]
    order = np.random.default_rng(seed).permutation(len(absent))[:ABSENT]
    every = [question for question in every if question[3]] + [absent[k] for k in order]
    for kind, text, noun, meant in every:
        hit = view.query(text)
        bare = bares.setdefault(noun, bares.get(noun) or view.query(noun))
        mask, point = judged(hit, meant)
        bare_mask, bare_point = judged(bare, meant)
        if kind == "how many":
            point = hit.count == len(meant)
            bare_point = len(bare.objects) == len(meant)
        yield Row(seed, words, kind, text, bool(meant), mask, point, bare_mask, bare_point)


def shares(rows: Sequence[Row], kind: str) -> Mapping[str, object]:
    """Right answers of the rows of a kind."""
    names = ("point", "bare_point", "mask", "bare_mask")
    means = {name: float(np.mean([getattr(row, name) for row in rows])) for name in names}
    return {"kind": kind, "n": len(rows), "rooms": len({row.room for row in rows}), **means}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--first", type=int, default=40)
    parser.add_argument("--rooms", type=int, default=20)
    given = parser.parse_args()
    threads.limit()
    kept = given.rows.read_text().splitlines() if given.rows and given.rows.exists() else []
    rows = [Row(*json.loads(line)) for line in kept]
    done = {row.room for row in rows}
    for seed in range(given.first, given.first + given.rooms):
        if seed in done:
            continue
        start = time.process_time()
        new = list(rows_of(seed))
        rows += new
        if given.rows:
            with given.rows.open("a") as file:
                file.writelines(json.dumps(row) + "\n" for row in new)
        print(
            f"room {seed}: {len(rows)} questions, {time.process_time() - start:.0f} s", flush=True
        )
    told = [row for row in rows if row.words == "told"]
    known_ = [row for row in rows if row.words == "lexicon"]

    def lines(kinds: Sequence[str], there: bool) -> list[dict]:
        found = []
        for name in (*kinds, "all"):
            which = kinds if name == "all" else (name,)
            own, other = (
                [row for row in of if row.kind in which and row.there == there]
                for of in (known_, told)
            )
            if own:
                found.append(shares(own, name) | {"told": shares(other, name)["point"]})
        return found

    columns = {"kind": ("question", str), "n": ("n", "d"), "point": ("point", ".2f")}
    columns |= {"bare_point": ("of the bare noun", ".2f"), "mask": ("mask", ".2f")}
    columns |= {"bare_mask": ("of the bare noun ", ".2f"), "told": ("true words", ".2f")}
    absent = {name: columns[name] for name in ("kind", "n", "point", "bare_point", "told")}
    counted = lines(("how many",), True)[:1]
    publish(
        "language/relations.md.j2",
        given.out and given.out / "relations.md",
        first=given.first,
        last=given.first + given.rooms - 1,
        there=lines(RELATIONS, True),
        absent=lines(RELATIONS, False),
        chosen=lines(SUPERLATIVES, True),
        counted=counted,
        columns=columns,
        absent_columns=absent | {"point": ("nothing found", ".2f")},
        counted_columns=absent
        | {"point": ("number right", ".2f"), "bare_point": ("objects", ".2f")},
        width=WIDTH,
        height=HEIGHT,
        most=ABSENT,
    )


if __name__ == "__main__":
    main()
