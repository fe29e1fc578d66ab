"""Quality of the photographs of a field: overlap, agreement, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from slgaussian.cameras.check import TURNED, WIDE, PairCheck, enough
from slgaussian.cameras.match_graph import neighbours
from slgaussian.geometry import SceneGeometry

LITTLE_SHARED = 0.3
"""Overlap below which most of a field is seen once, and its depth is a guess."""

GOOD, USABLE, POOR = "good", "usable", "poor"
"""What a scene may be called."""

MUCH_AGREEMENT, LEAST_AGREEMENT = 0.72, 0.3
LITTLE_CLASH, MOST_CLASH = 0.16, 0.22
"""Agreement from which, and clash up to which, a scene is good, and beyond which it is poor. Chosen
in sight of 26 pairs of photographs (`docs/measured/poses.md`): where depth is broken, clash is
0.35 and more, else at most 0.18."""


class Verdict(NamedTuple):
    """Verdict on a scene, with the reason and what to photograph instead, if it is not good."""

    level: str
    reason: str

    def sentence(self) -> str:
        """Return a line for people."""
        return f"scene: {self.level}" + (f": {self.reason}" if self.reason else "")


@dataclass(frozen=True)
class Quality:
    """Measures of how photographs fit together, each with those that show the same things.

    Attributes
    ----------
    overlap : float
        Fraction of the pixels of each view that show a surface, for which it falls inside the
        other; the smaller of the two. Of several views the median of what each shares with the one
        that it shares most with.
    confirmed : float
        Fraction of all such pixels whose surface another view shows at the same depth.
    angle : float or None
        Degrees between the lines of sight, median of the explained matches; None without any. Of
        several pairs the median.
    turn : float
        Degrees between their optical axes. Of several pairs the median.
    matches : int
        Of all pairs.
    explained : float
        Fraction of the matches that the cameras explain within ``pixels``.
    pixels : float
    judged : bool
        Whether the matches could tell right cameras from wrong ones.
    apart : int
        Views that share less than :data:`LITTLE_SHARED` with any other.
    agreement : float
        Fraction of the pixels that fall inside another view whose surface another view shows.
    clash : float
        Fraction of what another view should show that has another colour there
        (:meth:`slgaussian.geometry.SceneGeometry.clash`), the larger of two views. Of several the
        median of what each has with the one that it shares most with.
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

    def as_json(self) -> dict[str, Any]:
        """Plain numbers, four decimals."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}

    def summary(self) -> str:
        """One line for people."""
        angle = "" if self.angle is None else f", lines of sight {self.angle:.0f} degrees apart"
        note = "" if self.judged else " (too few agree to judge the cameras)"
        return (
            f"quality: views overlap by {self.overlap:.0%}{angle}; the cameras explain "
            f"{self.explained:.0%} of {self.matches} matches within {self.pixels:.1f} pixels{note}"
            f"; {self.depth}"
        )

    @property
    def depth(self) -> str:
        """A clause on how much of the depth is more than a guess, for terminal and page."""
        return f"another view confirms {self.confirmed:.0%} of the pixels"

    def verdict(self) -> Verdict:
        """Judge the scene by what its photographs say of each other; causes only give reasons."""
        if self.overlap < LITTLE_SHARED:
            return Verdict(
                POOR,
                f"a view shares {self.overlap:.0%} of what it shows with the other, and the depth "
                "of the rest is a guess; add a photograph from between",
            )
        level = POOR if self.agreement < LEAST_AGREEMENT or self.clash > MOST_CLASH else USABLE
        if self.agreement >= MUCH_AGREEMENT and self.clash <= LITTLE_CLASH:
            if not self.apart:
                return Verdict(GOOD, "")
            return Verdict(
                USABLE,
                f"views that share less than {LITTLE_SHARED:.0%} with any other: {self.apart}; "
                "most of their depth is a guess; add photographs from between",
            )
        clause = (
            f"of what two views show, they confirm {self.agreement:.0%} and contradict "
            f"{self.clash:.0%}"
        )
        if self.angle is not None and self.angle > WIDE:
            cause = f"the lines of sight are {self.angle:.0f} degrees apart"
        elif self.turn > TURNED:
            cause = f"the cameras are turned by {self.turn:.0f} degrees against each other"
        elif self.clash > LITTLE_CLASH:
            return Verdict(
                level,
                f"{clause}: something moved, shines or is thin; photograph what stands still, from "
                "places nearer to each other",
            )
        else:
            return Verdict(
                level,
                f"{clause}: much of it is blank or looks alike, and its depth a guess; add a "
                "photograph from between, with more texture in it",
            )
        return Verdict(level, f"{clause}: {cause}; add a photograph from between")


def measure(geometry: SceneGeometry, checks: Sequence[PairCheck]) -> tuple[Quality, np.ndarray]:
    """Measure the quality of views, and see which pixels another view confirms, bool [V, H, W].

    What they share is told by their predicted depths, the rest by the checks of pairs that show the
    same things (:func:`slgaussian.cameras.check.check_pairs`).
    """
    views, depths = geometry.views, geometry.depths
    shared = np.zeros(len(views))
    clash = np.zeros(len(views))
    confirmed, met = np.zeros(depths.shape, bool), np.zeros(depths.shape, bool)
    for a, b in neighbours(views):
        fractions = []
        for view_index, source in ((a, b), (b, a)):
            inside, same = geometry.seen_again(view_index, source)
            confirmed[view_index] |= same
            met[view_index] |= inside
            fractions.append(float(inside.sum() / max((depths[view_index] > 0).sum(), 1)))
        worst = max(geometry.clash(a, b), geometry.clash(b, a))
        for view in (a, b):
            if min(fractions) > shared[view]:
                shared[view], clash[view] = min(fractions), worst
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
        pixels=checks[0].pixels[0],
        judged=enough(matches, agreeing),
        apart=int((shared < LITTLE_SHARED).sum()),
        agreement=float(confirmed.sum() / max(met.sum(), 1)),
        clash=float(np.median(clash)),
    )
    return quality, confirmed
