"""Quality of the photographs of a field: overlap, agreement, verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from slgaussian.cameras.check import WIDE_AXIS_ANGLE, WIDE_TRIANGULATION_ANGLE, PairCheck, enough
from slgaussian.cameras.match_graph import neighbours
from slgaussian.geometry import SceneGeometry

LOW_OVERLAP = 0.3
"""Overlap below which most surfaces are visible in one view only and their depth is a guess."""

GOOD, USABLE, POOR = "good", "usable", "poor"
"""Levels of the verdict on a scene."""

GOOD_AGREEMENT, POOR_AGREEMENT = 0.72, 0.3
GOOD_CLASH, POOR_CLASH = 0.16, 0.22
"""A scene is good with agreement from the first and clash up to the first, and poor with agreement
below the second or clash above the second. Chosen on 26 pairs of photographs
(`docs/measured/poses.md`): clash is 0.35 and more where depth is wrong, else at most 0.18."""


GOOD_DETAIL = 0.5
"""Correlation of the details of a splat and of the photographs from which it is good: 0.6 and more
for splats that were trained by many photographs."""

MIN_PRECISE = 0.4
"""Fraction of the precise matches that cameras explain as precisely, below which they contradict
them: 0.68 and more with the cameras of annotated photographs, 0.39 with the worst poses of a
headset, mostly below 0.3 with those of other photographs of the same scene."""

CONFIDENCE_COEFFICIENTS = (2.53, 0.40, -7.92)
"""Logistic regression of right cameras, within 20 degrees: intercept, and the weights of the logit
of the matches' confidence and of clash, by ``benches.cameras.scene_evidence``
(`docs/measured/poses.md`)."""

MIN_CONFIDENCE, MAX_CONFIDENCE = 0.01, 0.99
"""Range to which the confidence by the matches is clipped: beyond it is not calibrated."""

DOUBTFUL_CONFIDENCE = 0.9
"""Confidence below which found cameras are doubted, whatever the matches say."""


class Verdict(NamedTuple):
    """Verdict on a scene, with the reason and what to photograph instead, if it is not good."""

    level: str
    reason: str = ""

    def sentence(self) -> str:
        """Return the verdict as one line of text."""
        return f"scene: {self.level}" + (f": {self.reason}" if self.reason else "")


@dataclass(frozen=True)
class Quality:
    """Measures of the consistency of photographs, over pairs that show the same objects.

    Attributes:
        overlap: Fraction of the surface pixels of each view that project into the other view; the
            smaller of the two. For several views, the median over views of the largest overlap with
            another view.
        confirmed: Fraction of all surface pixels whose surface another view shows at the same
            depth.
        angle: Degrees between the lines of sight, median of the explained matches, None without
            any; for several pairs the median over pairs.
        turn: Degrees between the optical axes; for several pairs the median.
        matches: Number of matches of all pairs.
        explained: Fraction of the matches that the cameras explain within ``pixels``.
        judged: Whether enough matches agree to judge the cameras.
        apart: Number of views that overlap every other by less than :data:`LOW_OVERLAP`.
        agreement: Fraction of the pixels that project into another view whose surface another view
            shows.
        clash: Fraction of the pixels visible in another view that have another colour there
            (:meth:`slgaussian.geometry.SceneGeometry.clash`), the larger of two views; for several
            views the median over views, each with the view that it overlaps most.
        detail, psnr: Agreement of a splat that existed with the photographs, see
            :class:`slgaussian.predict.splat_check.Agreement`; None for predicted Gaussians.
    """

    overlap: float
    confirmed: float
    angle: float | None
    turn: float
    matches: int
    explained: float
    pixels: float
    judged: bool
    apart: int = 0
    agreement: float = 1.0
    clash: float = 0.0
    contradicted: bool = False
    detail: float | None = None
    psnr: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return JSON-compatible numbers, rounded to four decimals."""
        numbers = {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}
        optional = "contradicted", "detail", "psnr"
        return {k: v for k, v in numbers.items() if k not in optional or v}

    def summary(self) -> str:
        """Return the measures as one line of text."""
        angle = "" if self.angle is None else f", lines of sight {self.angle:.0f} degrees apart"
        note = "" if self.judged else " (too few agree to judge the cameras)"
        return (
            f"quality: views overlap by {self.overlap:.0%}{angle}; the cameras explain "
            f"{self.explained:.0%} of {self.matches} matches within {self.pixels:.1f} pixels{note}"
            f"; {self.depth}"
        )

    @property
    def depth(self) -> str:
        """Return a clause on the confirmed fraction of the depth, for terminal and page."""
        return f"another view confirms {self.confirmed:.0%} of the pixels"

    def camera_confidence(self, by_matches: float) -> float:
        """Return the probability that cameras found from the photographs are right, 0 to 1.

        ``by_matches`` is the confidence of
        :class:`slgaussian.cameras.estimated.EstimatedCameras`, which has not seen the scene.
        """
        intercept, of_matches, of_clash = CONFIDENCE_COEFFICIENTS
        p = min(max(by_matches, MIN_CONFIDENCE), MAX_CONFIDENCE)
        logit = intercept + of_matches * math.log(p / (1 - p)) + of_clash * self.clash
        return 1 / (1 + math.exp(-logit))

    def verdict(self) -> Verdict:
        """Judge the scene by overlap, agreement and clash; angle and turn only give reasons.

        Gaussians that existed are judged by what they show of the photographs.
        """
        if self.detail is not None:
            if self.detail >= GOOD_DETAIL:
                return Verdict(GOOD)
            return Verdict(
                USABLE,
                f"the splat has {self.detail:.0%} of the detail of the photographs: it is blurred, "
                "or the cameras are not quite those by which it was trained",
            )
        if self.overlap < LOW_OVERLAP:
            return Verdict(
                POOR,
                f"a view shares {self.overlap:.0%} of what it shows with the other, and the depth "
                "of the rest is a guess; add a photograph from between",
            )
        if self.agreement >= GOOD_AGREEMENT and self.clash <= GOOD_CLASH:
            if not self.apart:
                unchecked = "too few matches agree to check the cameras, which are taken as given"
                return Verdict(GOOD, "" if self.judged else unchecked)
            return Verdict(
                USABLE,
                f"views that share less than {LOW_OVERLAP:.0%} with any other: {self.apart}; "
                "most of their depth is a guess; add photographs from between",
            )
        if self.contradicted:
            cause = "the cameras contradict the matches between the photographs; check that each "
            cause += "photograph has its own pose and intrinsics"
        elif self.angle is not None and self.angle > WIDE_TRIANGULATION_ANGLE:
            cause = f"lines of sight are {self.angle:.0f} degrees apart; add a photograph between"
        elif self.turn > WIDE_AXIS_ANGLE:
            cause = f"cameras are turned by {self.turn:.0f} degrees; add a photograph from between"
        elif self.clash > GOOD_CLASH:
            cause = "something moved, shines or is thin; photograph what stands still, from places "
            cause += "nearer to each other"
        else:
            cause = "much of it is blank or looks alike, and its depth a guess; add a photograph "
            cause += "from between, with more texture in it"
        return Verdict(
            POOR if self.agreement < POOR_AGREEMENT or self.clash > POOR_CLASH else USABLE,
            f"of what two views show, they confirm {self.agreement:.0%} and contradict "
            f"{self.clash:.0%}: {cause}",
        )


def camera_doubt(record: Mapping[str, Any]) -> str:
    """Return a sentence if found cameras may be wrong, else an empty string.

    ``record`` is that of :meth:`slgaussian.cameras.estimated.EstimatedCameras.as_json`, with
    the confidence of :meth:`Quality.camera_confidence`; empty if the cameras were given.
    """
    confidence, reason = record.get("confidence", 1.0), record.get("doubt", "")
    # Doubtful matches of a pair count even where the scene agrees; no chain of three or more
    # photographs had wrong cameras (docs/measured/poses.md).
    if confidence >= DOUBTFUL_CONFIDENCE and (not reason or len(record.get("pairs", ())) > 1):
        return ""
    reason = reason or "what one view shows has other colours in the other"
    return f"the cameras are right with a probability of {confidence:.0%}: {reason}"


def measure(geometry: SceneGeometry, checks: Sequence[PairCheck]) -> tuple[Quality, np.ndarray]:
    """Measure the quality of views, and find the pixels that another view confirms, bool [V, H, W].

    Overlap, agreement and clash come from the predicted depths, the other measures from the checks
    of informative pairs (:func:`slgaussian.cameras.check.check_pairs`).
    """
    views, depths = geometry.views, geometry.depths
    shared = np.zeros(len(views))
    nearest = [(0, 0)] * len(views)  # the pair of each view with the largest overlap
    confirmed, met = np.zeros(depths.shape, bool), np.zeros(depths.shape, bool)
    for pair in neighbours(views):
        fractions = []
        for view, source in (pair, pair[::-1]):
            inside, same = geometry.seen_again(view, source)
            confirmed[view] |= same
            met[view] |= inside
            fractions.append(float(inside.sum() / max((depths[view] > 0).sum(), 1)))
        for view in pair:
            if min(fractions) > shared[view]:
                shared[view], nearest[view] = min(fractions), pair
    clash = {
        (a, b): max(geometry.clash(a, b), geometry.clash(b, a)) if a != b else 0.0
        for a, b in set(nearest)
    }
    axes = {view.name: view.camera.c2w[:3, 2] for view in views}
    cosines = [axes[check.views[0]] @ axes[check.views[1]] for check in checks]
    angles = [check.angle for check in checks if np.isfinite(check.angle)]
    matches, agreeing = (sum(getattr(c, name) for c in checks) for name in ("matches", "agreeing"))
    quality = Quality(
        overlap=float(np.median(shared)),
        confirmed=float(confirmed.sum() / max((depths > 0).sum(), 1)),
        angle=float(np.median(angles)) if angles else None,
        turn=float(np.median(np.degrees(np.arccos(np.clip(cosines, -1, 1))))),
        matches=matches,
        explained=sum(check.coarse * check.matches for check in checks) / max(matches, 1),
        pixels=checks[0].pixels,
        judged=enough(matches, agreeing),
        apart=int((shared < LOW_OVERLAP).sum()),
        agreement=float(confirmed.sum() / max(met.sum(), 1)),
        clash=float(np.median([clash[pair] for pair in nearest])),
        contradicted=sum(c.precise * c.agreeing for c in checks) < MIN_PRECISE * agreeing,
    )
    return quality, confirmed
