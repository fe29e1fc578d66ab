"""Cameras that were found from photographs alone, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slgaussian.formats.brief import brief
from slgaussian.scene import Camera

GOOD, DOUBTFUL, UNUSED = "good", "doubtful", "unused"
"""Verdicts on a pair: its pose is trusted, uncertain, or not used at all."""


@dataclass(frozen=True)
class Focal:
    """A focal length and where it comes from.

    Attributes
    ----------
    pixels : float
        Of the whole photograph.
    low, high : float
        Ends of the interval that holds it nine times in ten, pixels.
    source : str
        "EXIF"; "matches", if they narrow down what is usual; "guess", if only what is usual is
        known; "given".
    """

    pixels: float
    low: float
    high: float
    source: str


@dataclass(frozen=True)
class FoundPair:
    """What two photographs say of each other.

    Attributes
    ----------
    views : (str, str)
    matches, inliers : int
        Points matched, and those that the relative pose explains.
    angle : float
        Degrees between the two lines of sight, median of the inliers; NaN without any.
    uncertainty : float
        Degrees by which rotation or direction of translation may be off, one standard deviation.
    verdict : str
        :data:`GOOD`, :data:`DOUBTFUL` or :data:`UNUSED`.
    said : str
        Why not good, a clause; "" if good.
    """

    views: tuple[str, str]
    matches: int
    inliers: int
    angle: float
    uncertainty: float
    verdict: str
    said: str


@dataclass(frozen=True, eq=False)
class FoundCameras:
    """Cameras of a few photographs, in one world.

    The world has the axes and the position of the first camera, and the first two are at distance
    1: photographs alone know no metres.

    Attributes
    ----------
    cameras : mapping str -> Camera
        By name, in the order of the photographs, for whole upright photographs; each says under
        ``estimated`` how it was found.
    focals : mapping str -> Focal
    k1 : mapping str -> float
        First radial distortion (OpenCV's) of each photograph; 0 unless enough views showed it.
    pairs : tuple of FoundPair
    points : float64 [N, 3]
        Where matched points lie.
    confidence : float
        0 to 1: that every pose is right to some degrees.
    warnings : tuple of str
        What the user had better know, a sentence each.
    """

    cameras: Mapping[str, Camera]
    focals: Mapping[str, Focal]
    k1: Mapping[str, float]
    pairs: tuple[FoundPair, ...]
    points: np.ndarray
    confidence: float
    warnings: tuple[str, ...] = ()

    __repr__ = brief

    def as_json(self) -> dict[str, Any]:
        """How the cameras were found, for people and programs that read it later."""
        return {
            "confidence": round(self.confidence, 3),
            "focals": {name: asdict(focal) for name, focal in self.focals.items()},
            "k1": dict(self.k1),
            "pairs": [asdict(pair) for pair in self.pairs],
            "warnings": list(self.warnings),
        }
