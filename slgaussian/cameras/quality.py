"""How good the ground is that a field stands on: what its photographs share and confirm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slgaussian.cameras.check import TURNED, WIDE, PairCheck
from slgaussian.geometry import SceneGeometry

LITTLE_SHARED = 0.3
"""Overlap below which most of a field is seen once, and its depth is a guess."""


@dataclass(frozen=True)
class Quality:
    """How well two photographs fit together; of several, the worst pair of neighbouring views.

    Attributes
    ----------
    overlap : float
        Fraction of the pixels of each view that show a surface, for which it falls inside the
        other; the smaller of the two.
    confirmed : float
        Fraction of all such pixels whose surface another view shows at the same depth.
    angle : float or None
        Degrees between the lines of sight, median of the explained matches; None without any.
    turn : float
        Degrees between their optical axes.
    matches : int
    explained : float
        Fraction of the matches that the cameras explain within ``pixels``.
    pixels : float
    judged : bool
        Whether the matches could tell right cameras from wrong ones.
    """

    overlap: float
    confirmed: float
    angle: float | None
    turn: float
    matches: int
    explained: float
    pixels: float
    judged: bool

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
            f"; another view confirms {self.confirmed:.0%} of the pixels"
        )

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
                f"the views share {self.overlap:.0%} of what they show, and the depth of the rest "
                "is a guess; add a photograph from between"
            )
        return found


def measure(geometry: SceneGeometry, checks: Sequence[PairCheck]) -> Quality:
    """The quality of views from their predicted depths, and from the checks of pairs of them."""
    cameras, depths = [view.camera for view in geometry.views], geometry.depths
    names = [view.name for view in geometry.views]
    overlaps, turns = [], []
    confirmed = np.zeros(depths.shape, bool)
    for check in checks:
        a, b = (names.index(name) for name in check.views)
        fractions = []
        for here, there in ((a, b), (b, a)):
            inside, same = geometry.seen_again(here, there)
            confirmed[here] |= same
            fractions.append(float(inside.sum() / max((depths[here] > 0).sum(), 1)))
        overlaps.append(min(fractions))
        cosine = cameras[a].c2w[:3, 2] @ cameras[b].c2w[:3, 2]
        turns.append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))
    worst = min(checks, key=lambda check: check.coarse)
    known = [check.angle for check in checks if np.isfinite(check.angle)]
    return Quality(
        overlap=min(overlaps),
        confirmed=float(confirmed.sum() / max((depths > 0).sum(), 1)),
        angle=max(known) if known else None,
        turn=max(turns),
        matches=worst.matches,
        explained=worst.coarse,
        pixels=worst.pixels[0],
        judged=worst.judged,
    )
