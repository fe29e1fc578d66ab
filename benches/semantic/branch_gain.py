"""Whether a trained branch earns its place: label IoU of novel views, and what training costs.

    python -m benches.semantic.branch_gain CACHE --data FOLDER -o docs/measured/branch.md

makes the rooms (a few seconds each, kept in CACHE), trains (a training that was interrupted goes
on), judges and writes the page. FOLDER holds real pairs, as for the other benches.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from benches.common.pages import publish
from benches.common.photograph_pairs import DATA_HELP, photographs
from benches.semantic.branch_rooms import HELD_OUT, TRAINING, Rooms, real_lessons
from slgaussian.benchmark.statistics import compare
from slgaussian.kernels import threads
from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.rasterize.planned import plan
from slgaussian.semantic import Lifting
from slgaussian.semantic.branch import (
    Architecture,
    Branch,
    BranchLifting,
    features_of,
    input_images,
    save_branch,
)
from slgaussian.semantic.corruption import KINDS, corrupt
from slgaussian.semantic.cross_view_labels import match_across_views
from slgaussian.semantic.evaluation import label_iou
from slgaussian.semantic.hard import Filled, HardIndex
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.training import train
from slgaussian.semantic.training_settings import TrainingSettings

WIDTHS = Architecture().widths
TRAINED = {
    "branch": Architecture(WIDTHS, others=False),
    "branch, others": Architecture(WIDTHS),
    "MLP, others": Architecture((), others=True),
}
STEPS = 500
SPEED_WIDTHS = ((8, 16, 16), (16, 24, 32), (16, 32, 48), WIDTHS)
ROUNDS = 5


def spent(work: Callable[[], object]) -> tuple[float, object]:
    """CPU seconds, the least of some rounds, which other programs on the machine disturb least."""
    seconds, made = [], None
    for _ in range(ROUNDS):
        begun = time.process_time()
        made = work()
        seconds.append(time.process_time() - begun)
    return min(seconds), made


def trained_liftings(
    rooms: Sequence[Lesson], cache: Path, steps: int
) -> tuple[dict[str, Lifting], list[dict]]:
    liftings: dict[str, Lifting] = {"hard": HardIndex(), "filled": Filled()}
    costs = [{"lifting": "hard"}, {"lifting": "filled"}]
    for name, architecture in TRAINED.items():
        folder = cache / f"{name} {steps}"
        begun = time.process_time()
        trained = train(rooms, TrainingSettings(architecture, steps), folder)
        note = folder / "minutes"
        if not note.is_file():
            note.write_text(str((time.process_time() - begun) / 60))
        liftings[name] = BranchLifting(trained.branch)
        size = len(save_branch(trained.branch)) / 1e3
        cost = {"steps": str(steps), "minutes": float(note.read_text()), "kilobytes": size}
        costs.append({"lifting": name, **cost})
    return liftings, costs


def judged(
    lessons: Sequence[Lesson],
    liftings: dict[str, Lifting],
    shown: Callable[[int], dict[str, np.ndarray]],
) -> list[dict]:
    """Rows of IoU; ``shown`` gives the labels of a lesson by what they are called."""
    scores: dict[tuple[str, str], list[float]] = {}
    for index, lesson in enumerate(lessons):
        kinds = {kind: corrupt(lesson.labels, rng_for(7, lesson.content, kind), kinds=(kind,))
                 for kind in KINDS}  # fmt: skip
        for labels, maps in {**shown(index), **kinds}.items():
            for name, score in label_iou(lesson, liftings, maps).items():
                scores.setdefault((labels, name), []).append(score)
    rows = []
    for (labels, name), own in scores.items():
        row = {"labels": labels, "lifting": name, "iou": float(np.nanmean(own))}
        if name != "hard":
            found = compare(own, scores[labels, "hard"])
            row |= {"gain": found.difference, "low": found.low, "high": found.high}
        rows.append(row)
    return rows


def parts(lesson: Lesson) -> list[dict]:
    """Time of a step's parts on one thread; the splat's others would wait for work, and count."""
    threads.limit(threads.cores())
    maps = LabelMaps(lesson.labels, np.ones(lesson.labels.shape, np.float32))
    rows = []
    for widths in SPEED_WIDTHS:
        branch = Branch(Architecture(widths))
        optimiser = torch.optim.AdamW(branch.parameters(), foreach=False)
        near, others = spent(lambda: match_across_views(lesson.gaussians, lesson.labels.shape))

        def look(others=others) -> torch.Tensor:
            codes = load_codes("separated")(maps, rng_for(0, "", ""))
            return input_images(maps.labels, maps.ids, codes, others)

        codes, images = spent(look)

        def forward(branch=branch, images=images) -> torch.Tensor:
            return features_of(branch, images, lesson.gaussians.source)

        with torch.no_grad():
            network, _ = spent(forward)
        planning, plans = spent(lambda: [plan(lesson.gaussians, c) for c in lesson.cameras])
        features = forward().detach()
        splat, _ = spent(lambda: [p.render(features) for p in plans])  # noqa: B023

        def both_ways(forward=forward, plans=plans) -> None:
            features = forward()
            sum(p.render(features).square().mean() for p in plans).backward()

        def both_ways_of_network(half: bool, forward=forward) -> None:
            with torch.autocast("cpu", torch.bfloat16, enabled=half):
                features = forward()
            features.float().square().mean().backward()

        there_and_back, _ = spent(both_ways)
        half, whole = (spent(lambda h=h: both_ways_of_network(h))[0] for h in (True, False))
        step, _ = spent(optimiser.step)
        row = {
            "widths": ", ".join(map(str, widths)),
            "others": near,
            "codes": codes,
            "forward": network,
            "plan": planning,
            "splat": splat,
            "backward": there_and_back - network - splat,
            "step": step,
        }
        whole_step = sum(value for value in row.values() if not isinstance(value, str))
        rows.append({**row, "all": whole_step, "half": half, "whole": whole})
    return rows


def lift_times(lesson: Lesson, liftings: dict[str, Lifting]) -> dict[str, float]:
    maps = LabelMaps(lesson.labels, np.ones(lesson.labels.shape, np.float32))
    codes = load_codes("separated")(maps, rng_for(0, "", ""))
    none = np.zeros((len(codes), 2), bool)
    bank = MemoryBank(maps.ids, codes, np.zeros((*none.shape, 1), np.float32), none)
    return {n: spent(lambda lift=lift: lift(lesson.gaussians, maps, bank))[0]
            for n, lift in liftings.items()}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cache", type=Path, help="folder for rooms and trainings")
    parser.add_argument("--data", type=photographs, required=True, help=DATA_HELP)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    threads.limit()
    rooms, held_out = (Rooms(given.cache, seeds) for seeds in (TRAINING, HELD_OUT))
    rooms.make()
    held_out.make()
    liftings, costs = trained_liftings(rooms, given.cache, given.steps)
    lifting_times = lift_times(held_out[0], liftings)
    real = real_lessons(given.data)
    rows = {
        "rooms": judged(
            held_out, liftings, lambda i: {"true": held_out[i].labels, "masks": held_out.found(i)}
        ),
        "real": judged(real, liftings, lambda i: {"as found": real[i].labels}),
        "parts": parts(held_out[0]),
        "costs": [{**cost, "lift": lifting_times[cost["lifting"]]} for cost in costs],
    }
    publish("semantic/branch.md.j2", given.output, rows=rows, count=len(rooms))


if __name__ == "__main__":
    main()
