"""Two context views around a view that is given: a labelled frame that is to be held out."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from slgaussian.datasets.pairs import Bounds, Pair, Views, score, sightings

NAME, VERSION = "around", 1
"""Name and version of the rule, as index files have them: within a version it chooses the same."""


@dataclass(frozen=True)
class Rule:
    """What is asked of two context views and the target that they surround.

    Attributes
    ----------
    bounds : Bounds
        Overlap and baseline of the two, how sharp and well exposed they must be.
    min_cover : float
        Least fraction of the target that at least one of the two sees, if all of it lies at the
        target's typical depth.
    max_aside : float
        How far the target may be from the middle between the two, as a fraction of their distance;
        below 0.5, so that it is between them, and nearer to none than the rest of that.
    """

    bounds: Bounds = field(default_factory=Bounds)
    min_cover: float = 0.9
    max_aside: float = 0.3

    def described(self) -> dict[str, Any]:
        """The rule and its settings, for an index file."""
        bounds = {name: value for name, value in asdict(self.bounds).items() if name != "most"}
        own = {"min_cover": self.min_cover, "max_aside": self.max_aside}
        return {"name": NAME, "version": VERSION, **bounds, **own}


@dataclass(frozen=True)
class Around:
    """Two context views of a target, or why there are none.

    Attributes
    ----------
    pair : Pair or None
    cover, aside : float
        As :class:`Rule` has them; 0 without a pair.
    reason : str
        Empty with a pair.
    """

    pair: Pair | None
    cover: float = 0.0
    aside: float = 0.0
    reason: str = ""


def surround(
    clip: Views, targets: Sequence[int], barred: Collection[int], rule: Rule
) -> list[Around]:
    """The best two context views of each target, neither of them among the barred or the targets.

    Of the pairs that fit the rule the one that scores most: the score of
    :func:`slgaussian.datasets.pairs.score` (overlap near the middle of its bounds, sharp views)
    times the cover, less up to a half for a target aside. Equal scores go to the earlier views, so
    there is no chance in it. The views need no order.
    """
    out = set(targets) | set(barred)
    usable = [int(i) for i in np.flatnonzero(clip.usable(rule.bounds)) if int(i) not in out]
    if len(usable) < 2:
        few = f"{len(usable)} of {len(clip.cameras)} views are sharp, well exposed and not held out"
        return [Around(None, reason=few) for _ in targets]
    if np.isnan(clip.depths).any():
        flat = "the views show no parallax that a depth could be found from"
        return [Around(None, reason=flat) for _ in targets]
    shown = [*usable, *targets]
    cameras = [clip.cameras[i] for i in shown]
    sights = list(sightings(cameras, clip.depths[shown]))
    pairs = _fitting(clip, usable, np.stack([s.mean(-1) for s in sights[: len(usable)]]), rule)
    a, b = np.array([pair.context for pair in pairs], np.int64).reshape(-1, 2).T
    place = np.full(len(clip.cameras), -1)
    place[shown] = np.arange(len(shown))
    centers = np.stack([camera.center for camera in clip.cameras])
    apart = np.linalg.norm(centers[a] - centers[b], axis=1)
    scores = np.array([pair.score for pair in pairs])
    found = []
    for target, sight in zip(targets, sights[len(usable) :], strict=True):
        aside = np.linalg.norm((centers[a] + centers[b]) / 2 - centers[target], axis=1) / apart
        cover = (sight[place[a]] | sight[place[b]]).mean(1)
        between = aside <= rule.max_aside
        good = between & (cover >= rule.min_cover)
        if good.any():
            values = scores * cover * (1 - 0.5 * aside / max(rule.max_aside, 1e-9))
            k = int(np.where(good, values, -1).argmax())
            pair = replace(pairs[k], targets=(target,), score=float(values[k]))
            found.append(Around(pair, float(cover[k]), float(aside[k])))
        else:
            reason = (
                f"{len(pairs)} pairs of views fit by overlap and baseline and are not held out; "
                f"{between.sum() or 'none'} of them have it between them"
            )
            reason += f", but see less than {rule.min_cover:g} of it" if between.any() else ""
            found.append(Around(None, reason=reason))
    return found


def _fitting(clip: Views, usable: list[int], seen: np.ndarray, rule: Rule) -> list[Pair]:
    """The pairs of usable views that fit the bounds, without targets, in order.

    Row a, column b of ``seen``: the fraction of the one that the other sees.
    """
    bounds = rule.bounds
    n = len(usable)
    centers = np.stack([clip.cameras[i].center for i in usable])
    depths, blur = clip.depths[usable], clip.blur[usable]
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
    baselines = apart / ((depths[:, None] + depths) / 2)
    shared = np.minimum(seen[:, :n], seen[:, :n].T)
    fits = (shared >= bounds.min_overlap) & (shared <= bounds.max_overlap) & (apart > 0)
    fits &= (baselines >= bounds.min_baseline) & (baselines <= bounds.max_baseline)
    return [
        Pair(
            (usable[a], usable[b]),
            (),
            float(shared[a, b]),
            float(baselines[a, b]),
            float(depths[[a, b]].mean()),
            score(float(shared[a, b]), blur[[a, b]], clip.blur, bounds),
        )
        for a, b in np.argwhere(np.triu(fits, 1)).tolist()
    ]
