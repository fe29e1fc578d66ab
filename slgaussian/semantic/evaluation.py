"""Score liftings by the objects that novel views show, on lessons they have not seen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.rasterize.planned import plan
from slgaussian.semantic import Lifting
from slgaussian.semantic.decode import Decoder, NearestCode
from slgaussian.semantic.lesson import Lesson


def label_iou(
    lesson: Lesson,
    liftings: Mapping[str, Lifting],
    labels: np.ndarray | None = None,
    codes: str = "separated",
    seed: int = 0,
    decoder: type[Decoder] | type[NearestCode] = Decoder,
) -> dict[str, float]:
    """Compute the mean IoU of the objects in the target views, as :func:`novel_labels` shows them.

    Pixels that the target labels leave open do not count. Worse ``labels`` are judged by the same
    objects, those in ``lesson.labels``: one that is lost counts 0.

    Returns
    -------
    {name: float}
        In [0, 1]: the mean over target views and the objects in each. NaN if there is none.
    """
    object_ids = np.unique(lesson.labels)
    object_ids = object_ids[object_ids > 0]
    scores = {}
    for name, views in novel_labels(lesson, liftings, labels, codes, seed, decoder).items():
        ious: list[float] = []
        for predicted, target in zip(views, lesson.targets, strict=True):
            ious += _ious(np.where(target > 0, predicted, 0), target, object_ids)
        scores[name] = float(np.mean(ious)) if ious else float("nan")
    return scores


def novel_labels(
    lesson: Lesson,
    liftings: Mapping[str, Lifting],
    labels: np.ndarray | None = None,
    codes: str = "separated",
    seed: int = 0,
    decoder: type[Decoder] | type[NearestCode] = Decoder,
) -> dict[str, np.ndarray]:
    """Render and decode the objects of the target views, as a field of these Gaussians shows them.

    Rendered with the planned splat and decoded by :mod:`slgaussian.semantic.decode`.

    Parameters
    ----------
    lesson : Lesson
    liftings : {name: Lifting}
        All get the same labels and codes.
    labels : int32 [V, H, W], optional
        What liftings are shown of the context views, by default the lesson's own labels.
    codes : str
        Code strategy by name; codes of one to three numbers.
    seed : int
        Decides the codes.
    decoder
        By default as a field decodes unless it is told otherwise.

    Returns
    -------
    {name: int32 [T, H, W]}
        Ids, 0 for none.
    """
    labels = lesson.labels if labels is None else labels
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    ids = maps.ids
    drawn = load_codes(codes)(maps, rng_for(seed, lesson.content, "judge"))
    nothing = np.zeros((len(ids), len(labels), 1), np.float32)
    bank = MemoryBank(ids, drawn, nothing, np.zeros(nothing.shape[:2], bool))
    decode = decoder(bank)
    lifted = {
        name: lift(lesson.gaussians, maps, bank).require_features()
        for name, lift in liftings.items()
    }
    predicted: dict[str, list[np.ndarray]] = {name: [] for name in liftings}
    for camera in lesson.cameras:
        planned = plan(lesson.gaussians, camera)
        for name, features in lifted.items():
            predicted[name].append(decode(planned.render(features).numpy())[0])
    return {name: np.stack(views) for name, views in predicted.items()}


def _ious(predicted: np.ndarray, target: np.ndarray, object_ids: np.ndarray) -> list[float]:
    """Intersection over union of each of the ``asked`` ids that the target shows."""
    # Rows of the table are the asked ids, from 1; whatever else there is, is 0.
    rows, columns = (
        np.where(np.isin(image, object_ids), np.searchsorted(object_ids, image) + 1, 0)
        for image in (target, predicted)
    )
    size = len(object_ids) + 1
    table = np.bincount((rows * size + columns).ravel(), minlength=size**2).reshape(size, size)
    shared, sizes = table.diagonal()[1:], table.sum(1)[1:]
    union = sizes + table.sum(0)[1:] - shared
    return (shared[sizes > 0] / union[sizes > 0]).tolist()
