"""What the lexicon knows of common things, and how well it finds those that photographs show.

    python -m benches.language.words_known DATA [-o docs/measured] [--rows FILE] [--seeds 3]

DATA holds ``office``, ``places`` and ``clip_text``. First, how many class names of public sets it
refuses (those of COCO, COCO-stuff and ADE20K are in ``class_names.toml``, those of LVIS in DATA).
Then every labelled pair is asked in its target for what is labelled there, as ``slgaussian
benchmark`` does. Rows are kept in FILE as they come, and what it holds is not done again.
"""

from __future__ import annotations

import argparse
import json
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benches.common.pages import publish
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import PLACES, labelled, read
from flows.config import SceneSettings, Settings
from slgaussian.benchmark.annotations import read_truth
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.language.query import Rules, ask
from slgaussian.language.vocabulary import NOUNS, Vocabulary, load_vocabulary

TITLES = {"coco": "COCO", "coco_stuff": "COCO-stuff", "ade20k": "ADE20K 150", "lvis": "LVIS"}


class Row(NamedTuple):
    """An answer: how much of the thing it found, and how it was read; "" if it was refused.

    ``rank`` is that of the best object that is mostly the thing, among those in view, from 1.
    """

    place: str
    scene: str
    seed: int
    text: str
    read_as: str
    few: bool
    iou: float
    point: bool
    rank: int | None


def class_names(data: Path) -> dict[str, list[str]]:
    """The names by set; what LVIS says in brackets, and COCO-stuff of leftovers, is left out."""
    lists = tomllib.loads((Path(__file__).parent / "class_names.toml").read_text("utf-8"))
    lvis = np.load(data / "clip_text" / "lvis_names_clip_text.npz")["names"]
    lists["lvis"] = [re.sub(r"\(.*?\)", "", str(name)).replace("_", " ").strip() for name in lvis]
    return lists


def few_nouns(known: Vocabulary) -> Vocabulary:
    """The vocabulary with no other nouns than those that things are told by."""

    def kept(name: str, family: str) -> bool:
        return family not in NOUNS or name in known.naming

    return replace(
        known,
        words={s: word for s, word in known.words.items() if kept(word.name, word.family)},
        phrases={s: word for s, word in known.phrases.items() if kept(word.name, word.family)},
    )


def refused(known: Vocabulary, names: Sequence[str]) -> dict[str, object]:
    """Shares of ``names`` that are refused, understood in part, or without a noun."""
    no, part, nounless = [], [], []
    for name in names:
        try:
            reading = known.read(name)
        except InputError:
            no.append(name)
            continue
        if reading.unknown:
            part.append(name)
        elif not any(word.family in NOUNS for word in reading.words):
            nounless.append(name)
    shares = [len(some) / len(names) for some in (no, part, nounless)]
    return dict(zip(("refused", "part", "nounless"), shares, strict=True)) | {
        "count": len(names),
        "names": no,
    }


def answers(place: str, scene: SceneSettings, seed: int, few: Vocabulary) -> Iterator[Row]:
    """The answers in the target of a labelled pair."""
    sample = read(scene, Settings())
    assert scene.labels is not None
    target = sample.targets[0]
    truth = read_truth(scene.labels, scene.categories, sample.targets).masks[target.name]
    field = build_field(sample, Method(seed=seed))
    view = field.render(target.camera)
    rows = np.searchsorted(field.bank.ids, view.ids)
    shown = view.ids > 0
    areas = np.bincount(rows[shown], minlength=len(field.bank))
    for text, mask in truth.items():
        if not mask.any():
            continue
        known = _reads(few, text)
        try:
            hit = ask([text], view._objects, field.reader, Rules())[0]
        except InputError:
            yield Row(place, scene.name, seed, text, "", known, 0.0, False, None)
            continue
        own = np.bincount(rows[shown & mask], minlength=len(field.bank)) > areas / 2
        gaps = field.reader.gaps([text], Rules())[0]
        order = [k for k in np.argsort(-gaps, kind="stable") if areas[k]]
        rank = next((1 + n for n, k in enumerate(order) if own[k]), None)
        iou = (mask & hit.mask).sum() / (mask | hit.mask).sum()
        on = hit.point is not None and bool(mask[hit.point[1], hit.point[0]])
        read_as = field.reader.understood(text).read_as
        yield Row(place, scene.name, seed, text, read_as, known, float(iou), on, rank)


def _reads(known: Vocabulary, text: str) -> bool:
    try:
        return not known.read(text).unknown
    except InputError:
        return False


def by_place(rows: Sequence[Row]) -> list[dict[str, object]]:
    """Means of the places, of the queries that the few nouns know and of the others."""
    found = []
    for place in ("office", *PLACES):
        own = [row for row in rows if row.place == place]
        line: dict[str, object] = {"place": place, "queries": len({(r.scene, r.text) for r in own})}
        for kind, some in (
            ("all", own),
            ("few", [row for row in own if row.few]),
            ("more", [row for row in own if not row.few]),
        ):
            if some:
                line[f"{kind} iou"] = float(np.mean([row.iou for row in some]))
                line[f"{kind} point"] = float(np.mean([row.point for row in some]))
        ranks = [row.rank for row in own if row.rank is not None]
        found.append(line | {"rank": float(np.mean(ranks))})
    return found


def by_text(rows: Sequence[Row]) -> list[dict[str, object]]:
    """Means of the queries that the few nouns do not know."""
    found = []
    for place, text in dict.fromkeys((row.place, row.text) for row in rows if not row.few):
        own = [row for row in rows if (row.place, row.text) == (place, text)]
        ranks = [row.rank for row in own if row.rank is not None]
        line = {
            "text": text,
            "place": place,
            "read_as": own[0].read_as or "refused",
            "iou": float(np.mean([row.iou for row in own])),
            "point": float(np.mean([row.point for row in own])),
        }
        found.append(line | ({"rank": float(np.mean(ranks))} if ranks else {}))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=data_folder("office", "places", "clip_text"))
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    threads.limit()
    known = load_vocabulary()
    few = few_nouns(known)
    sets = []
    for key, names in class_names(given.data).items():
        before = refused(few, names)
        sets.append(
            {"set": TITLES[key], **refused(known, names)}
            | {"few_refused": before["refused"], "few_part": before["part"]}
        )
    kept = given.rows.read_text().splitlines() if given.rows and given.rows.exists() else []
    rows = [Row(*json.loads(line)) for line in kept]
    done = {(row.place, row.scene, row.seed) for row in rows}
    for place in ("office", *PLACES):
        folder = place if place == "office" else f"places/{place}"
        for scene in labelled([folder], given.data):
            for seed in range(given.seeds):
                if (place, scene.name, seed) in done:
                    continue
                new = list(answers(place, scene, seed, few))
                rows += new
                if given.rows:
                    with given.rows.open("a") as file:
                        file.writelines(json.dumps(row) + "\n" for row in new)
                print(f"{place} {scene.name} seed {seed}: {len(new)} answers", flush=True)
    places = by_place(rows)
    publish(
        "language/words_known.md.j2",
        given.out and given.out / "words.md",
        sets=sets,
        nouns=len({word.name for word in known.words.values() if word.family in NOUNS}),
        spellings=len(known.words),
        naming=len(known.naming),
        seeds=given.seeds,
        places=places,
        means={
            key: float(np.mean([line[key] for line in places[1:] if key in line]))
            for key in ("all iou", "all point", "few iou", "rank")
        },
        texts=by_text(rows),
    )


if __name__ == "__main__":
    main()
