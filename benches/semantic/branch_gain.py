"""Gain of a trained branch: label IoU of novel views, and the cost of training.

    python -m benches.semantic.branch_gain CACHE OFFICE [-o docs/measured] [--steps 6000]
        [--paper 3] [--several 3] [--learn PLACE ...]

The bench makes rooms (a second each, stored in CACHE), trains the paper's network and ours with
several seeds (interrupted trainings are resumed, finished ones are read), and evaluates both. It
evaluates on the real pairs in OFFICE and trains on rooms and the pairs of each PLACE.
"""

import time
from collections.abc import Callable, Sequence
from itertools import chain, product
from pathlib import Path

import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import DATA_HELP, photographs
from benches.semantic.branch_rooms import HELD_OUT, LEARN_SIZE, TRAINING, Rooms, real_lessons
from slgaussian.benchmark.statistics import compare
from slgaussian.kernels import threads
from slgaussian.kernels.seeding import rng_for
from slgaussian.semantic import Lifting
from slgaussian.semantic.branch import Architecture, BranchLifting
from slgaussian.semantic.corruption import KINDS, corrupt
from slgaussian.semantic.decode import Decoder, NearestCode
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import Filled, HardIndex
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.training import Progress, TrainingSettings, train

TRAINED = {
    "paper": TrainingSettings(
        architecture=Architecture("paper", (16, 32, 64, 64), 64), corrupted=0.0, codes="grid"
    ),
    "several": TrainingSettings(),
}
"""Settings of `train --preset paper` and of `train`, except for the number of steps."""

DECODINGS = {
    "The paper's decoding (grid codes, the nearest)": {"codes": "grid", "decoder": NearestCode},
    "Decoding as fields here (separated codes, settled pixels)": {
        "codes": "separated",
        "decoder": Decoder,
    },
}

CORRUPTED = [
    *((rate, "wrong", tuple(KINDS)) for rate in (0.1, 0.3, 0.6)),
    *((0.3, kind, (kind,)) for kind in KINDS),
]
"""Share of the objects that are corrupted in one view, title, and kinds of corruption."""

REPEAT = 2
"""Number of times that each real lesson is used for each use of a room."""


def learn(
    lessons: Sequence[Lesson], cache: Path, steps: int, seeds: dict[str, int]
) -> tuple[dict[str, list[Lifting]], list[str]]:
    """Return the liftings of each network by seed, and the costs of trainings done now."""
    liftings: dict[str, list[Lifting]] = {name: [] for name in TRAINED}
    costs = []
    for name, seed in chain(*(product([name], range(seeds[name])) for name in TRAINED)):
        settings = TRAINED[name].model_copy(update={"steps": steps, "seed": seed})
        start, reached = time.process_time(), []

        def show(progress: Progress, name: str = name, reached: list[int] = reached) -> None:
            reached.append(progress.step)
            if progress.step % 200 == 0:
                print(f"{name} {progress}, {progress.seconds_left:.0f} s left", flush=True)

        trained = train(lessons, settings, cache / f"{name} {steps} {seed}", progress=show)
        if reached:
            spent = (time.process_time() - start) / len(reached)
            loss = trained.metrics["loss"].to_numpy()[-steps // 20 :].mean()
            costs.append(f"{name}, seed {seed}: {spent:.3f} CPU s a step, loss {loss:.5f}")
        liftings[name].append(BranchLifting(trained.branch))
    return liftings, costs


def judge(
    lessons: Sequence[Lesson],
    liftings: dict[str, list[Lifting]],
    labels_of: Callable[[int], dict[str, np.ndarray]],
    **decoding: object,
) -> list[dict]:
    """Return a row per kind of labels: the IoU of ``hard``, and the gains of other liftings.

    ``labels_of`` returns the labels of a lesson by name. With several seeds, the interval over
    lessons is that of the mean over seeds, and the gain of each seed follows.
    """
    plain = {"hard": [HardIndex()], "filled": [Filled()], **liftings}
    named = {(name, seed): lift for name, lifts in plain.items() for seed, lift in enumerate(lifts)}
    scores: dict[str, dict[tuple[str, int], list[float]]] = {}
    for index, lesson in enumerate(lessons):
        corrupted = {
            f"{rate:.0%} {name}": corrupt(
                lesson.labels, rng_for(7, lesson.content, name), rate, kinds
            )
            for rate, name, kinds in CORRUPTED
        }
        for labels, maps in {**labels_of(index), **corrupted}.items():
            for key, score in label_iou(lesson, named, maps, **decoding).items():
                scores.setdefault(labels, {}).setdefault(key, []).append(score)
        print(f"judged {lesson.sample}", flush=True)
    rows = []
    for labels, of_key in scores.items():
        hard = np.array(of_key["hard", 0])
        row: dict[str, object] = {"labels": labels}
        for name, lifts in plain.items():
            seeds = np.array([of_key[name, seed] for seed in range(len(lifts))])
            gain = compare(seeds.mean(0).tolist(), hard.tolist())
            row[name] = f"{gain.difference:+.3f} ({gain.low:+.3f} to {gain.high:+.3f})"
            if len(lifts) > 1:
                gains = np.nanmean(seeds - hard, axis=1)
                row[name] += "; " + " ".join(f"{each:+.3f}" for each in gains)
        row["hard"] = float(np.nanmean(hard))
        rows.append(row)
    return rows


def main() -> None:
    arguments = parser(__doc__, "branch.md")
    arguments.add_argument("cache", type=Path, help="folder for rooms and trainings")
    arguments.add_argument("office", type=photographs, help=DATA_HELP)
    arguments.add_argument("--learn", type=photographs, nargs="*", default=[], help=DATA_HELP)
    arguments.add_argument("--steps", type=int, default=6000)
    for name in TRAINED:
        arguments.add_argument(f"--{name}", type=int, default=3, help="seeds of the network")
    args = arguments.parse_args()
    threads.limit(1)
    rooms, held_out = (Rooms(args.cache, seeds) for seeds in (TRAINING, HELD_OUT))
    rooms.make()
    held_out.make()
    # Keep lessons in memory, so that evidence of other views is computed once.
    lessons = [rooms[i] for i in range(len(rooms))]
    for place in args.learn:
        lessons += real_lessons(place, LEARN_SIZE) * REPEAT
    seeds = {name: getattr(args, name) for name in TRAINED}
    liftings, costs = learn(lessons, args.cache, args.steps, seeds)
    columns = {"labels": ("labels", str), "hard": ("hard: IoU", ".3f")}
    columns |= {name: (f"{name}: gain", str) for name in ("filled", *liftings)}
    real = real_lessons(args.office)
    blocks = []
    for title, decoding in DECODINGS.items():
        room_rows = judge(
            held_out,
            liftings,
            lambda i: {"true": held_out[i].labels, "masks": held_out.mask_labels(i)},
            **decoding,
        )
        office = judge(real, liftings, lambda i: {"as found": real[i].labels}, **decoding)
        blocks += [f"{title}, rooms that no training saw:", table(room_rows, columns)]
        blocks += [f"{title}, pairs of photographs of the office:", table(office, columns)]
    publish(
        args.out,
        "branch.md",
        "python -m benches.semantic.branch_gain CACHE OFFICE --learn PLACE ...",
        *blocks,
        f"{args.steps} steps. Seeds: {seeds}. " + "; ".join(costs) + ".",
    )


if __name__ == "__main__":
    main()
