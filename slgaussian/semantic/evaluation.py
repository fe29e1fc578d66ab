"""Evaluation of liftings: IoU of objects in novel views, on held-out lessons."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.rasterize import rasterize
from slgaussian.semantic import Lifting
from slgaussian.semantic.decode import Decoder
from slgaussian.semantic.lesson import Lesson


def label_iou(
    lesson: Lesson, liftings: Mapping[str, Lifting], codes: str = "separated", seed: int = 0
) -> dict[str, float]:
    """Render and decode the target views, as a field would, and compare ids with target labels.

    Unlabelled target pixels, and objects that no context view shows, are ignored.

    Args:
        liftings: {name: Lifting}. All get the same labels and codes.
        codes: Name of the code strategy.
        seed: Seed of the codes.

    Returns:
        {name: float}: Mean IoU over target views and the objects in each. NaN without objects.
    """
    maps = LabelMaps(lesson.labels, np.ones(lesson.labels.shape, np.float32))
    drawn = load_codes(codes)(maps, rng_for(seed, lesson.content, "judge"))
    nothing = np.zeros((len(maps.ids), len(lesson.labels), 1), np.float32)
    bank = MemoryBank(maps.ids, drawn, nothing, np.zeros(nothing.shape[:2], bool))
    decode, scores = Decoder(bank), {}
    for name, lift in liftings.items():
        features = lift(lesson.gaussians, maps, bank).require_features()
        ious: list[float] = []
        for camera, target in zip(lesson.cameras, lesson.targets, strict=True):
            rendered = rasterize(lesson.gaussians, features, camera).values
            predicted = np.where(target > 0, decode(rendered.numpy())[0], 0)
            for id_ in np.intersect1d(target, maps.ids):
                truth, answer = target == id_, predicted == id_
                ious.append(float((truth & answer).sum() / (truth | answer).sum()))
        scores[name] = float(np.mean(ious)) if ious else float("nan")
    return scores
