"""How good the ground is that a field stands on: what its photographs share and confirm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slgaussian.cameras.check import TURNED, WIDE, PairCheck
from slgaussian.scene import Camera

CONFIRMS = 0.02
"""Two views show one surface where their depths differ by at most this fraction."""

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


def measure(
    cameras: Sequence[Camera], depths: np.ndarray, checks: Sequence[PairCheck], names: Sequence[str]
) -> Quality:
    """The quality of views from their z-depths float [V, H, W], 0 where unknown, and their checks.

    ``names`` are those of the views, in order, which the checks speak of.
    """
    overlaps, turns = [], []
    confirmed = np.zeros(depths.shape, bool)
    for check in checks:
        a, b = (names.index(name) for name in check.views)
        fractions = []
        for here, there in ((a, b), (b, a)):
            inside, same = _seen_again(cameras[here], depths[here], cameras[there], depths[there])
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


def _seen_again(
    camera: Camera, depth: np.ndarray, other: Camera, its: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels' surfaces fall inside another view, and which it shows there: bool [H, W]."""
    pixels, z = other.project(camera.unproject(depth))
    inside = (depth > 0) & (z > 0) & (pixels >= 0).all(-1)
    inside &= (pixels < (other.width, other.height)).all(-1)
    u, v = np.where(inside[..., None], pixels, 0).astype(np.int64).transpose(2, 0, 1)
    shown = its[v, u]
    return inside, inside & (shown > 0) & (np.abs(z - shown) <= CONFIRMS * shown)
