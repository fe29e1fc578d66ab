"""Cameras estimated from photographs alone, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.datasets.lens import Maps, lens_maps
from slgaussian.io import short_repr
from slgaussian.scene import Camera

GOOD, DOUBTFUL, UNUSED = "good", "doubtful", "unused"
"""Verdicts on a pair: its pose is reliable, uncertain, or not used."""


@dataclass(frozen=True)
class Focal:
    """A focal length and its source.

    Attributes:
        pixels: Focal length of the whole photograph.
        low, high: Limits of the 90 % interval, pixels.
        source: "EXIF"; "matches", if matches narrow the prior of typical focal lengths; "guess", if
            only the prior is known; "given".
    """

    pixels: float
    low: float
    high: float
    source: str


@dataclass(frozen=True)
class EstimatedPair:
    """Relative pose of two photographs: its support and verdict.

    Attributes:
        views: (str, str)
        matches, inliers: Numbers of matches, and of matches that the relative pose explains.
        angle: Degrees between the two lines of sight, median of the inliers; NaN without any.
        uncertainty: Standard deviation of the rotation or direction of translation, degrees.
        verdict: :data:`GOOD`, :data:`DOUBTFUL` or :data:`UNUSED`.
        reason: Reason if not good, a clause; else "".
    """

    views: tuple[str, str]
    matches: int
    inliers: int
    angle: float
    uncertainty: float
    verdict: str
    reason: str


@dataclass(frozen=True, eq=False)
class EstimatedCameras:
    """Cameras of a few photographs in one world frame.

    The world frame is that of the first camera, and the distance of the first two cameras is 1:
    photographs alone do not determine the metric scale.

    Attributes:
        cameras: mapping str -> Camera. Cameras of the whole upright photographs by name, in the
            order of the photographs. The attribute ``estimated`` of each gives its source and
            uncertainty.
        focals: mapping str -> Focal
        pairs: tuple of EstimatedPair
        confidence: Probability, 0 to 1, that every pose is right to a few degrees.
        doubt: Reason to doubt the cameras, a clause; empty if the matches give none. Whether the
            cameras are right is decided by the scene
            (:func:`slgaussian.cameras.quality.camera_doubt`).
        warnings: tuple of str. Warnings for the user, a sentence each.
        left_out: mapping str -> str. Reason, a clause, for each photograph whose camera could not
            be estimated.
        distortions: mapping str -> float. Brown's k1 of photographs whose distortion was estimated;
            the cameras are those of the undistorted photographs.
        matches: Matches of the pairs that were solved, pixels of the whole photographs, undistorted
            if their cameras are.
    """

    cameras: Mapping[str, Camera]
    focals: Mapping[str, Focal]
    pairs: tuple[EstimatedPair, ...]
    confidence: float
    doubt: str = ""
    warnings: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    distortions: Mapping[str, float] = field(default_factory=dict)
    matches: MatchGraph | None = None

    __repr__ = short_repr

    def lenses(self) -> dict[str, Callable[[], Maps]]:
        """Return functions that compute the undistortion maps of distorted photographs."""
        return {
            name: partial(lens_maps, camera.K, (camera.width, camera.height), (k1,))
            for name, k1 in self.distortions.items()
            for camera in [self.cameras[name]]
        }

    def as_json(self) -> dict[str, Any]:
        """Return the estimation record as JSON-compatible data, for files."""
        return {
            "confidence": round(self.confidence, 3),
            "doubt": self.doubt,
            "focals": {name: asdict(focal) for name, focal in self.focals.items()},
            "pairs": [
                {key: _plain(value) for key, value in asdict(pair).items()} for pair in self.pairs
            ],
            "warnings": list(self.warnings),
            "left_out": dict(self.left_out),
            **({"distortions": dict(self.distortions)} if self.distortions else {}),
        }

    def summary(self) -> str:
        """Return one line of text: range of the focal lengths, and support of the weakest pair."""
        pixels = [focal.pixels for focal in self.focals.values()]
        low = min(focal.low for focal in self.focals.values())
        high = max(focal.high for focal in self.focals.values())
        sources = " and ".join(sorted({focal.source for focal in self.focals.values()}))
        several = f" to {max(pixels):.0f}" if max(pixels) - min(pixels) >= 1 else ""
        used = [pair for pair in self.pairs if pair.verdict != UNUSED] or self.pairs
        weakest = min(used, key=lambda pair: pair.inliers)
        total = len(self.cameras) + len(self.left_out)
        of_some = f" of {len(self.cameras)} of {total} photographs" if self.left_out else ""
        return (
            f"cameras found{of_some}: focal length {min(pixels):.0f}{several} pixels ({low:.0f} to "
            f"{high:.0f}, from {sources}); of two photographs, {weakest.inliers} of "
            f"{weakest.matches} matches agree at least"
        )


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def describe_cameras(cameras: Iterable[Camera]) -> str:
    """Describe the origin of cameras: given, or estimated, with the source of focal lengths."""
    estimates = [camera.estimated for camera in cameras if camera.estimated is not None]
    if not estimates:
        return "given"
    sources = " and ".join(sorted({estimate.source for estimate in estimates}))
    return f"estimated, focal length from {sources}"
