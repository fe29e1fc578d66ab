"""Accuracy and calibration of answers: fits the constants of the lexicon's confidence.

    python -m benches.language.answer_confidence DATA [-o docs/measured] [--rows FILE] [--seeds 3]

DATA holds ``office``, ``places`` and ``things``; the classifier must be installed. Each labelled
pair is queried for the labels of its target, and for things that its place does not have. An answer
is a mask, right if its IoU with the truth is above 0.5, and a point, right if it lies on the thing.
For each place the constants are fitted to all other places; the shipped constants are fitted to
all. The three kinds of places have equal weights, and so have the places of a kind, and present and
absent things. Rows are appended to FILE, and scenes in it are not measured again.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import PLACES, THINGS, build_fields, find_labelled, read
from flows.config import SceneSettings, Settings
from slgaussian.benchmark.annotations import read_truth
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.language.answer import MIN_POINT_PROBABILITY, Signs, ask
from slgaussian.language.answer import signs as measure_signs
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader

RIDGE = 0.002

OUTDOORS = "grass, bed, toilet, bathtub, road, brick wall, gravel, green grass, fence, cobblestone \
road, refrigerator, oven, tree"
TABLES = "bed, toilet, bathtub, refrigerator, oven, banana, laptop, keyboard, piano, guitar, \
bicycle, foosball table, coffee machine, red crate, towel, fireplace, truck"
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
ALL_PLACES = ("office", *PLACES, *THINGS)
ABSENT = {
    "office": f"{OUTDOORS}, purple tablecloth, pink flowers, leather pouf, pink placemat, towel",
    "castle": INDOORS,
    "street": INDOORS,
    "dining": f"{OUTDOORS}, sky, foosball table, coffee machine, red crate, beige sofa, purple \
tablecloth, blue carpet, carpet",
    "kitchen": f"{OUTDOORS}, sky, sofa, foosball table, qr code, blue carpet, green plant, carpet, \
poster",
    "bonsai": f"{OUTDOORS}, sky, foosball table, qr code, blue carpet, coffee machine, sofa",
    **dict.fromkeys(THINGS, TABLES),
    "lounge": f"{OUTDOORS}, sky, pink flowers, purple tablecloth, blue box, foosball table",
}
"""Things that no photograph of a place shows, checked by eye, in addition to :data:`NOWHERE`."""


class Row(NamedTuple):
    """One answer: its predictors of confidence, and whether it is right."""

    place: str
    scene: str
    seed: int
    text: str
    present: bool
    gap: float
    measurements: int
    stands_out: float
    parts: float
    named: float
    mask: bool
    point: bool

    @property
    def evidence(self) -> float:
        return self.gap * self.measurements


PREDICTORS = ("evidence", "stands_out", "parts", "named")
"""Predictors of the confidence."""


def answers(place: str, scene: SceneSettings, seeds: Sequence[int]) -> Iterator[Row]:
    """Return the answers in the target of a labelled pair, by the field of each seed."""
    sample = read(scene, Settings())
    assert scene.labels is not None
    target = sample.targets[0]
    truth = read_truth(scene.labels, scene.categories, sample.targets).masks[target.name]
    for inputs in build_fields(sample, seeds):
        object_map = ObjectMap(inputs.field.render(target.camera).ids, inputs.bank.ids)
        for answer in answer_labels(place, object_map, inputs.field.reader, truth):
            yield Row(place, scene.name, inputs.seed, *answer)


def answer_labels(
    place: str, object_map: ObjectMap, reader: BankReader, truth: Mapping[str, np.ndarray]
) -> Iterator[tuple]:
    """Yield the fields of a :class:`Row`, from ``text`` on, for each text asked at a place.

    Texts that the lexicon refuses, or cannot answer, are left out.
    """
    present_texts = [text for text, mask in truth.items() if mask.any()]
    for text in [*present_texts, *f"{ABSENT[place]}, {NOWHERE}".split(", ")]:
        try:
            hit = ask([text], object_map, reader, Rules())[0]
        except InputError:
            continue
        if hit.understood.untold:
            continue
        gaps = reader.gaps([text], Rules())[0][hit.ranked]
        asks, named = hit.understood.measurements, hit.understood.named
        at = measure_signs(gaps, hit.chosen[hit.ranked], asks, object_map.parts(hit.chosen))
        present = text in present_texts
        right = truth[text] if present else np.zeros_like(hit.mask)
        union = (right | hit.mask).sum()
        on = present and hit.point is not None and bool(right[hit.point[1], hit.point[0]])
        good = bool(union and (right & hit.mask).sum() / union > 0.5)
        yield text, present, float(gaps.max()), asks, at.stands_out, at.parts, named, good, on


def weights(rows: Sequence[Row]) -> np.ndarray:
    """Return weights float64 [M], equal in sum over kinds, places, and present or absent."""
    groups = Counter((row.place, row.present) for row in rows)
    places = Counter(find_kind(place) for place in {row.place for row in rows})
    return np.array(
        [1 / groups[row.place, row.present] / places[find_kind(row.place)] for row in rows]
    )


def find_kind(place: str) -> str:
    """Return the kind of a place: office, places or things."""
    return place if place == "office" else "things" if place in THINGS else "places"


def signs(rows: Sequence[Row], on: Sequence[str]) -> np.ndarray:
    """Return the design matrix of the named predictors with an intercept: float64 [M, S + 1]."""
    return np.array([[*(getattr(row, name) for name in on), 1.0] for row in rows])


def fit(rows: Sequence[Row], measure: str, predictors: Sequence[str] = PREDICTORS) -> np.ndarray:
    """Fit the logistic curve of ``mask`` or ``point`` with a weak ridge: float64 [S + 1]."""
    X, w = signs(rows, predictors), weights(rows)
    right = np.array([getattr(row, measure) for row in rows])
    w, scale = w / w.sum(), np.append(X[:, :-1].std(0), 0)

    def loss(b: np.ndarray) -> tuple[float, np.ndarray]:
        z = X @ b
        p = expit(z)
        cost = w @ np.logaddexp(0, np.where(right, -z, z)) + RIDGE * ((b * scale) ** 2).sum()
        return cost, X.T @ (w * (p - right)) + 2 * RIDGE * scale**2 * b

    return minimize(loss, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B").x


def left_out(rows: Sequence[Row], measure: str, on: Sequence[str] = PREDICTORS) -> np.ndarray:
    """Return cross-validated probabilities float64 [M], leaving one place out."""
    out = np.zeros(len(rows))
    for place in {row.place for row in rows}:
        in_place = np.array([row.place == place for row in rows])
        training = [row for row in rows if row.place != place]
        out[in_place] = expit(signs(rows, on)[in_place] @ fit(training, measure, on))
    return out


def auroc(p: np.ndarray, right: np.ndarray, w: np.ndarray) -> float:
    """Compute the weighted area under the ROC curve; ties count half."""
    above = (p[right][:, None] > p[~right]) + 0.5 * (p[right][:, None] == p[~right])
    both = w[right][:, None] * w[~right]
    return float((above * both).sum() / both.sum())


def bins(p: np.ndarray, right: np.ndarray, w: np.ndarray, count: int = 10) -> list[dict]:
    """Return the calibration curve by weighted deciles: predicted and observed accuracy."""
    order = np.argsort(p, kind="stable")
    rank = (np.cumsum(w[order]) - w[order] / 2) / w.sum()
    tenths = [order[(rank * count).astype(int) == k] for k in range(count)]
    return [
        {
            "said": float(np.average(p[members], weights=w[members])),
            "right": float(np.average(right[members], weights=w[members])),
            "share": float(w[members].sum() / w.sum()),
        }
        for members in tenths
        if len(members)
    ]


def judge(rows: Sequence[Row], measure: str, predictors: Sequence[str] = PREDICTORS) -> dict:
    """Evaluate the cross-validated probabilities of ``mask`` or ``point``."""
    p, w = left_out(rows, measure, predictors), weights(rows)
    right = np.array([getattr(row, measure) for row in rows])
    places = np.array([row.place for row in rows])
    curve = bins(p, right, w)
    by_place = {
        place: auroc(p[places == place], right[places == place], w[places == place])
        for place in ALL_PLACES
    }
    error = sum(decile["share"] * abs(decile["said"] - decile["right"]) for decile in curve)
    return {
        "what": measure,
        "constants": fit(rows, measure, predictors),
        "auroc": auroc(p, right, w),
        "error": error,
        "by_place": by_place,
        "bins": curve,
    }


def verdicts(rows: Sequence[Row]) -> list[dict]:
    """Return the verdicts by the shipped constants, a line per kind of places and one for all."""
    shipped = Lexicon.calibration.mask, Lexicon.calibration.point
    mask, point = (
        np.array([curve(Signs(*signs([row], PREDICTORS)[0, :-1])) for row in rows])
        for curve in shipped
    )
    present, w = np.array([row.present for row in rows]), weights(rows)
    kinds = np.array([find_kind(row.place) for row in rows])
    denied = point < MIN_POINT_PROBABILITY
    accepted = ~denied & (mask >= 0.5)

    def share(which: np.ndarray, of: np.ndarray) -> float:
        return float(w[of & which].sum() / w[of].sum())

    lines = []
    for kind in ("things", "office", "places", "all"):
        in_kind = (kinds == kind) | (kind == "all")
        line = {"kind": kind, "denied": share(denied, in_kind & present)}
        line |= {
            "absent denied": share(denied, in_kind & ~present),
            "found": share(accepted, in_kind & present),
        }
        line |= {"absent found": share(accepted, in_kind & ~present)}
        lines.append(line | {"right": share(~present, in_kind & denied)})
    return lines


def main() -> None:
    arguments = parser(__doc__, "words.md")
    arguments.add_argument("data", type=data_folder("office", "places", "things"))
    arguments.add_argument("--rows", type=Path)
    arguments.add_argument("--seeds", type=int, default=3)
    args = arguments.parse_args()
    threads.limit()
    stored = args.rows.read_text().splitlines() if args.rows and args.rows.exists() else []
    rows = [Row(*json.loads(line)) for line in stored]
    done = {(row.place, row.scene, row.seed) for row in rows}
    for place in ALL_PLACES:
        kind = find_kind(place)
        folder = place if kind == place else f"{kind}/{place}"
        for scene in find_labelled([folder], args.data):
            seeds = [s for s in range(args.seeds) if (place, scene.name, s) not in done]
            new = list(answers(place, scene, seeds)) if seeds else []
            rows += new
            if args.rows:
                with args.rows.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in new)
            print(f"{place} {scene.name}: {len(new)} answers", flush=True)
    both = [judge(rows, measure) for measure in ("mask", "point")]
    columns = {"what": ("probability that it is right", str)}
    columns |= {"auroc": ("AUROC", ".3f"), "error": ("calibration error", ".3f")}
    columns |= {place: (place, ".2f") for place in both[0]["by_place"]}
    tenths = [
        {f"{result['what']} {name}": tenth[name] for result in both for name in ("said", "right")
         if k < len(result["bins"]) and (tenth := result["bins"][k])}
        for k in range(10)
    ]  # fmt: skip
    of_tenths = {
        f"{measure} {name}": (f"{measure}: {name}", ".2f")
        for measure in ("mask", "point") for name in ("said", "right")
    }  # fmt: skip
    names = (*PREDICTORS, "offset")
    constants = [
        {"what": result["what"], **dict(zip(names, result["constants"], strict=True))}
        for result in both
    ]
    publish(
        args.out,
        "words.md",
        "python -m benches.language.answer_confidence DATA",
        f"{len(rows)} answers of {args.seeds} seeds, {sum(row.present for row in rows)} to things "
        "that are there.",
        table([result | result["by_place"] for result in both], columns),
        table(tenths, of_tenths),
        "Not here is said where the point is right with less than "
        f"{MIN_POINT_PROBABILITY}, found where the mask is with at least 0.5; with the "
        "constants that ship:",
        table(
            verdicts(rows),
            {
                "kind": ("places", str),
                "found": ("there: found", ".0%"),
                "denied": ("there: not here", ".0%"),
                "absent found": ("absent: found", ".0%"),
                "absent denied": ("absent: not here", ".0%"),
                "right": ("not here is right", ".0%"),
            },
        ),
        "Constants fitted to all places. Those of the mask that ship are of an earlier fit, of "
        "which only slope and offset were fitted anew: it finds fewer absent things.",
        table(
            constants,
            {
                "what": ("of the", str),
                **{name: (name.replace("_", " "), ".3f") for name in names},
            },
        ),
    )


if __name__ == "__main__":
    main()
