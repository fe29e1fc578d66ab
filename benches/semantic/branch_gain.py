"""Whether a trained branch earns its place: label IoU of novel views, and what training costs.

    python -m benches.semantic.branch_gain CACHE DATA [-o docs/measured] [--steps 500]

It makes rooms (a few seconds each, kept in CACHE), trains (a training that was interrupted goes
on) and judges. DATA holds real pairs, as for other benches.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import DATA_HELP, photographs
from benches.semantic.branch_rooms import HELD_OUT, TRAINING, Rooms, real_lessons
from slgaussian.benchmark.statistics import compare
from slgaussian.kernels import threads
from slgaussian.kernels.seeding import rng_for
from slgaussian.semantic import Lifting
from slgaussian.semantic.branch import Architecture, BranchLifting
from slgaussian.semantic.corruption import KINDS, corrupt
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import Filled, HardIndex
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.training import TrainingSettings, train

WIDTHS = Architecture().widths
TRAINED = {"branch": Architecture(WIDTHS, others=False), "branch, others": Architecture(WIDTHS)}


def trained_liftings(
    rooms: Sequence[Lesson], cache: Path, steps: int
) -> tuple[dict[str, Lifting], dict[str, float]]:
    """Liftings by name, and CPU minutes of their training where it ran now."""
    liftings: dict[str, Lifting] = {"hard": HardIndex(), "filled": Filled()}
    minutes = {}
    for name, architecture in TRAINED.items():
        start = time.process_time()
        trained = train(rooms, TrainingSettings(architecture, steps), cache / f"{name} {steps}")
        minutes[name] = (time.process_time() - start) / 60
        liftings[name] = BranchLifting(trained.branch)
    return liftings, minutes


def judged(
    lessons: Sequence[Lesson],
    liftings: dict[str, Lifting],
    shown: Callable[[int], dict[str, np.ndarray]],
) -> list[dict]:
    """A row a kind of labels: IoU of ``hard``, and by how much others are better.

    ``shown`` gives the labels of a lesson by what they are called.
    """
    scores: dict[tuple[str, str], list[float]] = {}
    for index, lesson in enumerate(lessons):
        kinds = {kind: corrupt(lesson.labels, rng_for(7, lesson.content, kind), kinds=(kind,))
                 for kind in KINDS}  # fmt: skip
        for labels, maps in {**shown(index), **kinds}.items():
            for name, score in label_iou(lesson, liftings, maps).items():
                scores.setdefault((labels, name), []).append(score)
    rows: dict[str, dict] = {}
    for (labels, name), own in scores.items():
        row = rows.setdefault(labels, {"labels": labels})
        if name == "hard":
            row[name] = float(np.nanmean(own))
        else:
            gain = compare(own, scores[labels, "hard"])
            row[name] = f"{gain.difference:+.3f} ({gain.low:+.3f} to {gain.high:+.3f})"
    return list(rows.values())


def main() -> None:
    arguments = parser(__doc__, "branch.md")
    arguments.add_argument("cache", type=Path, help="folder for rooms and trainings")
    arguments.add_argument("data", type=photographs, help=DATA_HELP)
    arguments.add_argument("--steps", type=int, default=500)
    asked = arguments.parse_args()
    threads.limit()
    rooms, held_out = (Rooms(asked.cache, seeds) for seeds in (TRAINING, HELD_OUT))
    rooms.make()
    held_out.make()
    liftings, minutes = trained_liftings(rooms, asked.cache, asked.steps)
    real = real_lessons(asked.data)
    columns = {"labels": ("labels", str), "hard": ("hard: IoU", ".3f")}
    columns |= {name: (f"{name}: gain", str) for name in liftings if name != "hard"}
    publish(
        asked.out,
        "branch.md",
        "python -m benches.semantic.branch_gain CACHE DATA",
        "Rooms that no training saw:",
        table(
            judged(
                held_out,
                liftings,
                lambda i: {"true": held_out[i].labels, "masks": held_out.found(i)},
            ),
            columns,
        ),
        "Real pairs:",
        table(judged(real, liftings, lambda i: {"as found": real[i].labels}), columns),
        f"{asked.steps} steps took "
        + ", ".join(f"{spent:.1f} CPU minutes ({name})" for name, spent in minutes.items())
        + ".",
    )


if __name__ == "__main__":
    main()
