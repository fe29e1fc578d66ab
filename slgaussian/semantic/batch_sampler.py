"""Sampling of training batches: lessons, context labels (clean or corrupted) and target views.

A batch depends only on the settings, the lessons and the step number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.kernels.seeding import rng_for
from slgaussian.semantic.corruption import corrupt
from slgaussian.semantic.lesson import Lesson

if TYPE_CHECKING:
    from slgaussian.semantic.training import TrainingSettings

CORRUPTED_FRACTION = 0.5
"""Fraction of the objects that are corrupted where context labels are corrupted."""

TRAINED_KINDS = ("missing", "eroded")
"""Kinds of corruption used in training. Wrong and merged ids are excluded: if two views disagree,
little indicates which is right, and the mean of both codes, which minimises the squared error, may
decode as a third object. Training on merged ids as well lowered the IoU on merged ids by 0.02 after
450 steps and by 0.03 after 1000."""


@dataclass(frozen=True, eq=False)
class Draw:
    """One lesson of a batch.

    Attributes
    ----------
    lesson : Lesson
    labels : int32 [V, H, W]
        Context labels, the branch's input: the lesson's own labels, or corrupted ones.
    corrupted : bool
    views : list of int
        Indices of the target views.
    epoch : int
        Number of completed passes over all lessons.
    rng : numpy Generator
        Draws the codes.
    """

    lesson: Lesson
    labels: np.ndarray
    corrupted: bool
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
        corrupted = bool(rng.random() < settings.corrupted)
        labels = lesson.labels
        if corrupted:
            labels = corrupt(labels, rng, CORRUPTED_FRACTION, TRAINED_KINDS)
        views = sorted(rng.permutation(len(lesson.cameras))[: settings.targets].tolist())
        batch.append(Draw(lesson, labels, corrupted, views, epoch, rng))
    return batch
