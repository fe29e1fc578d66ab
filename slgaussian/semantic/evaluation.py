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
    """Compute the mean IoU of :func:`novel_labels` with the target labels.

    Unlabelled target pixels, and objects that no context view shows, are ignored.

    Returns:
        {name: float}: In [0, 1]: the mean over target views and the objects in each. NaN without
            objects.
    """
    object_ids = np.unique(lesson.labels[lesson.labels > 0])
    scores = {}
    for name, views in novel_labels(lesson, liftings, codes, seed).items():
        ious: list[float] = []
        for predicted, target in zip(views, lesson.targets, strict=True):
            for id_ in np.intersect1d(target, object_ids):
                truth, answer = target == id_, (predicted == id_) & (target > 0)
                ious.append(float((truth & answer).sum() / (truth | answer).sum()))
        scores[name] = float(np.mean(ious)) if ious else float("nan")
    return scores


def novel_labels(
    lesson: Lesson, liftings: Mapping[str, Lifting], codes: str = "separated", seed: int = 0
) -> dict[str, np.ndarray]:
    """Render and decode the object ids of the target views, as a field would.

    Args:
        liftings: {name: Lifting}. All get the same labels and codes.
        codes: Name of the code strategy.
        seed: Seed of the codes.

    Returns:
        {name: int32 [T, H, W]}: Ids, 0 for none.
    """
    maps = LabelMaps(lesson.labels, np.ones(lesson.labels.shape, np.float32))
    drawn = load_codes(codes)(maps, rng_for(seed, lesson.content, "judge"))
    nothing = np.zeros((len(maps.ids), len(lesson.labels), 1), np.float32)
    bank = MemoryBank(maps.ids, drawn, nothing, np.zeros(nothing.shape[:2], bool))
    decode = Decoder(bank)
    predicted = {}
    for name, lift in liftings.items():
        features = lift(lesson.gaussians, maps, bank).require_features()
        rendered = [rasterize(lesson.gaussians, features, c).values for c in lesson.cameras]
        predicted[name] = np.stack([decode(values.numpy())[0] for values in rendered])
    return predicted
