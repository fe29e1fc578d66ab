"""How good the ground is that a field stands on: what its photographs share and confirm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slgaussian.cameras.check import TURNED, WIDE, PairCheck, enough
from slgaussian.cameras.match_graph import neighbours
from slgaussian.geometry import SceneGeometry

LITTLE_SHARED = 0.3
"""Overlap below which most of a field is seen once, and its depth is a guess."""


@dataclass(frozen=True)
class Quality:
    """How well photographs fit together, each with those that show the same things.

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

    def as_json(self) -> dict[str, Any]:
        """Plain numbers, four decimals."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}

    def summary(self) -> str:
        """One line for people."""
        angle = "" if self.angle is None else f", lines of sight {self.angle:.0f} degrees apart"
        told = "" if self.judged else " (too few agree to judge the cameras)"
        return (
            f"quality: views overlap by {self.overlap:.0%}{angle}; the cameras explain "
            f"{self.explained:.0%} of {self.matches} matches within {self.pixels:.1f} pixels{told}"
            f"; {self.depth}"
        )

    @property
    def depth(self) -> str:
        """A clause on how much of the depth is more than a guess, for terminal and page."""
        return f"another view confirms {self.confirmed:.0%} of the pixels"

    def warnings(self) -> list[str]:
        """What the user had better know, a sentence each."""
        found = []
        if self.angle is not None and self.angle > WIDE:
            found.append(
                f"the lines of sight are {self.angle:.0f} degrees apart, and above {WIDE:.0f} "
                "depth is often wrong; add a photograph from between"
            )
        elif self.turn > TURNED:
            found.append(
                f"the cameras are turned by {self.turn:.0f} degrees against each other, and above "
                f"{TURNED:.0f} depth is often wrong; add a photograph from between"
            )
        if self.overlap < LITTLE_SHARED:
            found.append(
                f"a view shares {self.overlap:.0%} of what it shows with the other, and the depth "
                "of the rest is a guess; add a photograph from between"
            )
        elif self.apart:
            found.append(
                f"views that share less than {LITTLE_SHARED:.0%} with any other: {self.apart}; "
                "most of their depth is a guess; add photographs from between"
            )
        return found


def measure(geometry: SceneGeometry, checks: Sequence[PairCheck]) -> tuple[Quality, np.ndarray]:
    """Measure the quality of views, and see which pixels another view confirms, bool [V, H, W].

    What they share is told by their predicted depths, the rest by the checks of pairs that show the
    same things (:func:`slgaussian.cameras.check.check_pairs`).
    """
    views, depths = geometry.views, geometry.depths
    shared = np.zeros(len(views))
    confirmed = np.zeros(depths.shape, bool)
    for a, b in neighbours(views):
        fractions = []
        for here, there in ((a, b), (b, a)):
            inside, same = geometry.seen_again(here, there)
            confirmed[here] |= same
            fractions.append(float(inside.sum() / max((depths[here] > 0).sum(), 1)))
        shared[[a, b]] = np.maximum(shared[[a, b]], min(fractions))
    axes = {view.name: view.camera.c2w[:3, 2] for view in views}
    cosines = [axes[check.views[0]] @ axes[check.views[1]] for check in checks]
    known = [check.angle for check in checks if np.isfinite(check.angle)]
    matches, agreeing = (sum(getattr(c, name) for c in checks) for name in ("matches", "agreeing"))
    quality = Quality(
        overlap=float(np.median(shared)),
        confirmed=float(confirmed.sum() / max((depths > 0).sum(), 1)),
        angle=float(np.median(known)) if known else None,
        turn=float(np.median(np.degrees(np.arccos(np.clip(cosines, -1, 1))))),
        matches=matches,
        explained=sum(check.coarse * check.matches for check in checks) / max(matches, 1),
        pixels=checks[0].pixels[0],
        judged=enough(matches, agreeing),
        apart=int((shared < LITTLE_SHARED).sum()),
    )
    return quality, confirmed
