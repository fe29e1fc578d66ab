"""How often answers are right, and what tells: fits the constants of the lexicon's confidence.

    python -m benches.language.answer_confidence DATA [-o docs/measured] [--rows FILE] [--seeds 3]

DATA holds ``office`` and ``places``. Every labelled pair is asked for what is labelled in its
target, and for things that its place has not. An answer is a mask, right if its IoU with the truth
is above 0.5, and a point, right if it lies on the thing. Constants for one place are fitted to the
others; those that ship, to all. Places count alike, and what is there as much as what is not. Rows
are kept in FILE as they come, and what it holds is not done again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import PLACES, built, labelled, read
from flows.config import SceneSettings, Settings
from slgaussian.benchmark.annotations import read_truth
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.language import confidence
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import BankReader, Rules, ask

KEPT = 0.85
"""Share of the right answers that are to be told from what is not there."""

RIDGE = 0.002

OUTDOORS = "grass, bed, toilet, bathtub, road, brick wall, gravel, green grass, fence, cobblestone \
road, refrigerator, oven, tree"
INDOORS = (
    "sofa, bed, bottle, mug, cushion, carpet, backpack, laptop, keyboard, refrigerator, oven, \
sink, toilet, bathtub, towel, pillow, vase, banana, wooden table, grey sofa, pink placemat, coffee \
machine, foosball table, wooden floor, book"
)
NOWHERE = (
    "elephant, giraffe, zebra, cow, horse, sheep, bear, airplane, boat, bus, train, traffic light, \
stop sign, fire hydrant, surfboard, skis, pizza, sandwich, broccoli, toothbrush, hair dryer, \
umbrella, guitar, piano, motorcycle, kite"
)
NOT_THERE = {
    "office": f"{OUTDOORS}, purple tablecloth, pink flowers, leather pouf, pink placemat, towel",
    "castle": INDOORS,
    "street": INDOORS,
    "dining": f"{OUTDOORS}, sky, foosball table, coffee machine, red crate, beige sofa, purple \
tablecloth, blue carpet, carpet",
    "kitchen": f"{OUTDOORS}, sky, sofa, foosball table, qr code, blue carpet, green plant, carpet, \
poster",
    "bonsai": f"{OUTDOORS}, sky, foosball table, qr code, blue carpet, coffee machine, sofa",
    "lounge": f"{OUTDOORS}, sky, pink flowers, purple tablecloth, blue box, foosball table",
}
"""What no photograph of a place shows, by eye, beside :data:`NOWHERE`, which none of any does."""


class Row(NamedTuple):
    """One answer: what it rests on, and whether it is right."""

    place: str
    scene: str
    seed: int
    text: str
    there: bool
    gap: float
    measurements: int
    stands_out: float
    parts: float
    mask: bool
    point: bool

    @property
    def evidence(self) -> float:
        return self.gap * self.measurements


RESTS_ON = ("evidence", "stands_out", "parts")
"""What confidence rests on."""


def answers(place: str, scene: SceneSettings, seeds: Sequence[int]) -> Iterator[Row]:
    """The answers in the target of a labelled pair, by the field of each seed."""
    sample = read(scene, Settings())
    assert scene.labels is not None
    target = sample.targets[0]
    truth = read_truth(scene.labels, scene.categories, sample.targets).masks[target.name]
    for inputs in built(sample, seeds):
        seen = ObjectMap(inputs.field.render(target.camera).ids, inputs.bank.ids)
        for text, *found in answered(place, seen, inputs.field.reader, truth):
            yield Row(place, scene.name, inputs.seed, text, *found)


def answered(
    place: str, seen: ObjectMap, reader: BankReader, truth: Mapping[str, np.ndarray]
) -> Iterator[tuple]:
    """Of each text that is asked at a place, it and the last fields of its :class:`Row`.

    Texts that the lexicon refuses have none.
    """
    asked = [text for text, mask in truth.items() if mask.any()]
    for text in [*asked, *f"{NOT_THERE[place]}, {NOWHERE}".split(", ")]:
        try:
            hit = ask([text], seen, reader, Rules())[0]
        except InputError:
            continue
        gaps = reader.gaps([text], Rules())[0][hit._ranked]
        asks = hit.understood.measurements
        at = confidence.signs(gaps, hit._chosen[hit._ranked], asks, seen.parts(hit._chosen))
        there = text in asked
        right = truth[text] if there else np.zeros_like(hit.mask)
        union = (right | hit.mask).sum()
        on = there and hit.point is not None and bool(right[hit.point[1], hit.point[0]])
        good = bool(union and (right & hit.mask).sum() / union > 0.5)
        yield text, there, float(gaps.max()), asks, at.stands_out, at.parts, good, on


def weights(rows: Sequence[Row]) -> np.ndarray:
    """Of rows float64 [M]: places alike, and in each what is there as much as what is not."""
    groups = [(row.place, row.there) for row in rows]
    return np.array([1 / groups.count(group) for group in groups])


def signs(rows: Sequence[Row], on: Sequence[str]) -> np.ndarray:
    """Those numbers of the rows that are named, and ones: float64 [M, S + 1]."""
    return np.array([[*(getattr(row, name) for name in on), 1.0] for row in rows])


def fitted(rows: Sequence[Row], what: str, on: Sequence[str] = RESTS_ON) -> np.ndarray:
    """Constants float64 [S + 1] of the logistic curve of ``mask`` or ``point``, a little held
    back."""
    X, w = signs(rows, on), weights(rows)
    right = np.array([getattr(row, what) for row in rows])
    w, scale = w / w.sum(), np.append(X[:, :-1].std(0), 0)

    def loss(b: np.ndarray) -> tuple[float, np.ndarray]:
        z = X @ b
        p = expit(z)
        cost = w @ np.logaddexp(0, np.where(right, -z, z)) + RIDGE * ((b * scale) ** 2).sum()
        return cost, X.T @ (w * (p - right)) + 2 * RIDGE * scale**2 * b

    return minimize(loss, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B").x


def left_out(rows: Sequence[Row], what: str, on: Sequence[str] = RESTS_ON) -> np.ndarray:
    """Probabilities float64 [M], of every place by constants of the other ones."""
    out = np.zeros(len(rows))
    for place in {row.place for row in rows}:
        own = np.array([row.place == place for row in rows])
        others = [row for row in rows if row.place != place]
        out[own] = expit(signs(rows, on)[own] @ fitted(others, what, on))
    return out


def auroc(p: np.ndarray, right: np.ndarray, w: np.ndarray) -> float:
    """Weighted probability that a right one is above a wrong one; half for ties."""
    above = (p[right][:, None] > p[~right]) + 0.5 * (p[right][:, None] == p[~right])
    both = w[right][:, None] * w[~right]
    return float((above * both).sum() / both.sum())


def bins(p: np.ndarray, right: np.ndarray, w: np.ndarray, count: int = 10) -> list[dict]:
    """Tenths of the weight by probability: what was said, and what was right."""
    order = np.argsort(p, kind="stable")
    at = (np.cumsum(w[order]) - w[order] / 2) / w.sum()
    tenths = [order[(at * count).astype(int) == k] for k in range(count)]
    return [
        {
            "said": float(np.average(p[own], weights=w[own])),
            "right": float(np.average(right[own], weights=w[own])),
            "share": float(w[own].sum() / w.sum()),
        }
        for own in tenths
        if len(own)
    ]


def judged(rows: Sequence[Row], what: str, on: Sequence[str] = RESTS_ON) -> dict:
    """How well the probabilities of ``mask`` or ``point`` do at places left out."""
    p, w = left_out(rows, what, on), weights(rows)
    right = np.array([getattr(row, what) for row in rows])
    places = np.array([row.place for row in rows])
    curve = bins(p, right, w)
    by_place = {
        place: auroc(p[places == place], right[places == place], w[places == place])
        for place in ("office", *PLACES)
    }
    error = sum(one["share"] * abs(one["said"] - one["right"]) for one in curve)
    return {
        "what": what,
        "constants": fitted(rows, what, on),
        "auroc": auroc(p, right, w),
        "error": error,
        "by_place": by_place,
        "bins": curve,
    }


def false_found(rows: Sequence[Row], on: Sequence[str] = RESTS_ON) -> dict[str, float]:
    """The probability of a point above which :data:`KEPT` of the right ones lie, and what else."""
    p, w = left_out(rows, "point", on), weights(rows)
    point, there = (np.array([getattr(row, name) for row in rows]) for name in ("point", "there"))
    limit = float(np.quantile(p[point], 1 - KEPT))
    selected = np.array([row.gap > 0 for row in rows])
    places = np.array([row.place for row in rows])

    def share(which: np.ndarray, of: np.ndarray) -> float:
        return float(w[of & which].sum() / w[of].sum())

    by_place = {
        place: share(p >= limit, ~there & (places == place)) for place in ("office", *PLACES)
    }
    return {
        "by_place": by_place,
        "limit": limit,
        "before": share(selected, ~there),
        "after": share(p >= limit, ~there),
        "kept": share(p >= limit, there),
    }


def main() -> None:
    arguments = parser(__doc__, "words.md")
    arguments.add_argument("data", type=data_folder("office", "places"))
    arguments.add_argument("--rows", type=Path)
    arguments.add_argument("--seeds", type=int, default=3)
    asked = arguments.parse_args()
    threads.limit()
    known = asked.rows.read_text().splitlines() if asked.rows and asked.rows.exists() else []
    rows = [Row(*json.loads(line)) for line in known]
    done = {(row.place, row.scene, row.seed) for row in rows}
    for place in ("office", *PLACES):
        folder = place if place == "office" else f"places/{place}"
        for scene in labelled([folder], asked.data):
            seeds = [s for s in range(asked.seeds) if (place, scene.name, s) not in done]
            new = list(answers(place, scene, seeds)) if seeds else []
            rows += new
            if asked.rows:
                with asked.rows.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in new)
            print(f"{place} {scene.name}: {len(new)} answers", flush=True)
    both = [judged(rows, what) for what in ("mask", "point")]
    columns = {"what": ("probability that it is right", str)}
    columns |= {"auroc": ("AUROC", ".3f"), "error": ("calibration error", ".3f")}
    columns |= {place: (place, ".2f") for place in both[0]["by_place"]}
    tenths = [
        {f"{one['what']} {name}": tenth[name] for one in both for name in ("said", "right")
         if k < len(one["bins"]) and (tenth := one["bins"][k])}
        for k in range(10)
    ]  # fmt: skip
    of_tenths = {
        f"{what} {name}": (f"{what}: {name}", ".2f")
        for what in ("mask", "point") for name in ("said", "right")
    }  # fmt: skip
    found = false_found(rows)
    constants = [
        {"what": one["what"], **dict(zip((*RESTS_ON, "offset"), one["constants"], strict=True))}
        for one in both
    ]
    publish(
        asked.out,
        "words.md",
        "python -m benches.language.answer_confidence DATA",
        f"{len(rows)} answers of {asked.seeds} seeds, {sum(row.there for row in rows)} to things "
        "that are there.",
        table([one | one["by_place"] for one in both], columns),
        table(tenths, of_tenths),
        f"Without confidence, {found['before']:.0%} of the things that are not there are found. At "
        f"a limit of {found['limit']:.2f}, which {KEPT:.0%} of the right points reach, "
        f"{found['after']:.0%} are, and {found['kept']:.0%} of those that are there. By place: "
        + ", ".join(f"{place} {share:.0%}" for place, share in found["by_place"].items())
        + f". The limit that ships is {confidence.ABSENT}.",
        "Constants fitted to all places:",
        table(
            constants,
            {
                "what": ("of the", str),
                **{n: (n.replace("_", " "), ".3f") for n in (*RESTS_ON, "offset")},
            },
        ),
    )


if __name__ == "__main__":
    main()
