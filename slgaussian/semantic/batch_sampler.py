"""Sampling of training batches: lessons and target views.

A batch depends only on the settings, the lessons and the step number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.kernels.seeding import rng_for
from slgaussian.semantic.lesson import Lesson

if TYPE_CHECKING:
    from slgaussian.semantic.training import TrainingSettings


@dataclass(frozen=True, eq=False)
class Draw:
    """One lesson of a batch.

    Attributes:
        views: list of int. Indices of the target views.
        epoch: Number of completed passes over all lessons.
        rng: numpy Generator. Draws the codes.
    """

    lesson: Lesson
    views: list[int]
    epoch: int
    rng: np.random.Generator


def draw_batch(lessons: Sequence[Lesson], settings: TrainingSettings, step: int) -> list[Draw]:
    """Draw the lessons of ``step`` (counted from 0), without replacement within an epoch."""
    batch = []
    for number in range(step * settings.batch, (step + 1) * settings.batch):
        epoch, place = divmod(number, len(lessons))
        order = rng_for(settings.seed, "", f"order {epoch}").permutation(len(lessons))
        lesson = lessons[int(order[place])]
        rng = rng_for(settings.seed, lesson.content, f"step {epoch}")
        views = sorted(rng.permutation(len(lesson.cameras))[: settings.targets].tolist())
        batch.append(Draw(lesson, views, epoch, rng))
    return batch
