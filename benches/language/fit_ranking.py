"""Fit the ranking of wholes to labelled places, with leave-one-place-out validation.

    python -m benches.language.fit_ranking DATA [--rooms 24]

DATA holds ``office``, ``places`` and ``things``. A ranking is a softmax over the candidates of a
text, fitted by cross-entropy to exp(IoU / :data:`SHARPNESS`). Kinds of places have equal weights,
and so have the places of a kind. The bench prints the weights fitted to all places; and, for the
shipped weights, those fitted to all, and those fitted to the other places, the mean IoU and the
share of texts with IoU above 0.5.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import torch

from benches.common.harness import parser, table
from benches.common.photograph_pairs import data_folder
from benches.scores.scene_sets import SETS, SHEETS, build_fields, read, read_truth_of_scene
from flows.config import SceneSettings, Settings
from flows.scenes import room_scene
from slgaussian.errors import InputError
from slgaussian.kernels import threads
from slgaussian.language.answer import find_candidates
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.wholes import Ranking

KINDS = ("things", "office", "places")
FIRST_ROOM, FOLDS = 100, 4
SHARPNESS, RIDGE = 0.1, 1e-3


@dataclass(frozen=True)
class Question:
    """A text with its candidates: ``features`` float64 [G, 13] and ``ious`` [G]."""

    kind: str
    place: str
    scene: str
    features: np.ndarray
    ious: np.ndarray


def questions(kind: str, scene: SceneSettings) -> list[Question]:
    """Query all labelled texts of a scene; an unusable text has one candidate of IoU 0."""
    sample = read(scene, Settings())
    truth = read_truth_of_scene(scene, sample)
    (inputs,) = build_fields(sample, [0])
    field, rules, collected = inputs.field, Rules(), []
    place = scene.name if kind == "rooms" else f"{kind}/{scene.dataset}"
    for target in sample.targets:
        object_map = ObjectMap(field.render(target.camera).ids, field.bank.ids)
        for text, mask in truth.masks[target.name].items():
            features, ious = np.zeros((1, len(Ranking._fields))), np.zeros(1)
            with suppress(InputError):
                gaps = field.reader.gaps([text], rules)
                candidates = find_candidates([text], gaps, object_map.areas, field.reader, rules)
                possible = candidates.possible[0]
                sets = candidates.objects[0][possible].astype(float)
                if len(sets):
                    features = candidates.features[0][possible]
                    inside, areas = sets @ object_map.areas_within(mask), sets @ object_map.areas
                    ious = inside / np.maximum(areas + mask.sum() - inside, 1)
            if mask.any():
                collected.append(Question(kind, place, scene.name, features, ious))
    return collected


def fit(items: Sequence[Question]) -> np.ndarray:
    """Fit the weights of a ranking, float64 [13]."""
    deviation = np.concatenate([q.features for q in items]).std(0) + 1e-9
    places = Counter(q.place for q in items)
    kinds = Counter(kind for kind, _ in {(q.kind, q.place) for q in items})
    counts = torch.tensor([1 / places[q.place] / kinds[q.kind] for q in items], dtype=torch.float64)
    features = [torch.from_numpy(q.features / deviation) for q in items]
    wanted = [torch.from_numpy(q.ious / SHARPNESS).softmax(0) for q in items]
    weights = torch.zeros(len(deviation), dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        losses = [
            -(w * (f @ weights).log_softmax(0)).sum() for f, w in zip(features, wanted, strict=True)
        ]
        total = (counts / counts.sum() * torch.stack(losses)).sum() + RIDGE * (weights**2).sum()
        total.backward()
        return total

    optimiser.step(loss)
    return weights.detach().numpy() / deviation


def scores(evaluated: Sequence[Question], choose: Callable[[Question], int]) -> dict[str, str]:
    """Return mean IoU / share above 0.5 of each kind, averaged over the scenes."""
    cells = {}
    for kind in (*KINDS, "rooms"):
        by_scene: dict[str, list[float]] = {}
        for q in evaluated:
            if q.kind == kind:
                by_scene.setdefault(q.scene, []).append(float(q.ious[choose(q)]))
        means = [(np.mean(ious), np.mean(np.array(ious) > 0.5)) for ious in by_scene.values()]
        if means:
            cells[kind] = "{:.3f} / {:.2f}".format(*np.mean(means, 0))
    return cells


def main() -> None:
    """Build the fields, fit, and print."""
    arguments = parser(__doc__)
    arguments.add_argument("data", type=data_folder(*SHEETS), metavar="DATA")
    arguments.add_argument("--rooms", type=int, default=24)
    options = arguments.parse_args()
    threads.limit(threads.cores())
    scenes = [(kind, scene) for kind in KINDS for scene in SETS[kind].scenes(options.data)]
    numbers = range(FIRST_ROOM, FIRST_ROOM + options.rooms)
    scenes += [("rooms", room_scene(number)) for number in numbers]
    collected = []
    for kind, scene in scenes:
        collected += questions(kind, scene)
        print(scene.name, len(collected), flush=True)

    def fold(q: Question) -> str:
        return f"rooms {int(q.place.rsplit('_')[-1]) % FOLDS}" if q.kind == "rooms" else q.place

    folds = sorted({fold(q) for q in collected})
    left_out = {f: fit([q for q in collected if fold(q) != f]) for f in folds}
    together, shipped = fit(collected), np.array(Lexicon.ranking)
    for name, weight in zip(Ranking._fields, together, strict=True):
        print(f"        {name}={weight:.2f},")
    ways: dict[str, Callable[[Question], int]] = {
        "as it ships": lambda q: int((q.features @ shipped).argmax()),
        "fitted to all": lambda q: int((q.features @ together).argmax()),
        "fitted to other places": lambda q: int((q.features @ left_out[fold(q)]).argmax()),
        "best candidate": lambda q: int(q.ious.argmax()),
    }
    rows = [{"weights": name, **scores(collected, choose)} for name, choose in ways.items()]
    print(table(rows, {name: (name, str) for name in ("weights", *KINDS, "rooms")}))


if __name__ == "__main__":
    main()
