"""The tracker that needs no weights and no geometry: dense optical flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slgaussian.masks.memory import Frame, MemoryTracker, both_ways, pixel_grid

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

AGREE_PIXELS = 2.0
AGREE_SHARE = 0.05
"""Forward and backward flow may disagree by the pixels, or by this share of the motion."""
STRONGEST = 300
"""Keypoints by which it is guessed how much of a view another one shows."""


@dataclass(frozen=True, eq=False)
class _FlowFrame(Frame):
    points: np.ndarray
    descriptors: np.ndarray | None
    strongest: np.ndarray | None


class FlowTracker(MemoryTracker):
    """Matches a remembered frame with a new one by dense flow, checked both ways.

    SIFT matches give a homography, the image warped by it gives DIS flow (Kroeger et al. 2016)
    small enough to find, so that steps of a hundred pixels are followed. Neither camera nor depth
    is read. The rest is :class:`slgaussian.masks.memory.MemoryTracker`.
    """

    def describe(self, seen: SeenView, labels: np.ndarray) -> Frame:
        """Add SIFT keypoints; see :meth:`slgaussian.masks.memory.MemoryTracker.describe`."""
        import cv2

        frame = super().describe(seen, labels)
        grey = seen.view.grey
        sift = cv2.SIFT_create(nfeatures=1500, contrastThreshold=0.02)
        keypoints, descriptors = sift.detectAndCompute(grey, None)
        points = np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2)
        strong = np.argsort([-point.response for point in keypoints], kind="stable")[:STRONGEST]
        strongest = None if descriptors is None else descriptors[strong]
        return _FlowFrame(
            **vars(frame), points=points, descriptors=descriptors, strongest=strongest
        )

    def shows(self, new: Frame, old: Frame) -> float:
        """Keypoints in both; see :meth:`slgaussian.masks.memory.MemoryTracker.shows`."""
        assert isinstance(new, _FlowFrame) and isinstance(old, _FlowFrame)  # as described
        return len(_good_matches(new.strongest, old.strongest))

    def match(self, new: Frame, old: Frame) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`slgaussian.masks.memory.MemoryTracker.match`."""
        assert isinstance(new, _FlowFrame) and isinstance(old, _FlowFrame)  # as described
        warp = _homography(new, old)
        here, before = new.seen.view.grey, old.seen.view.grey
        there = _flow(here, before, warp)
        back = _flow(before, here, np.linalg.inv(warp))
        return both_ways(there, back, AGREE_PIXELS, AGREE_SHARE)


def _homography(a: _FlowFrame, b: _FlowFrame) -> np.ndarray:
    """The homography float64 [3, 3] that most SIFT matches follow; the identity if there is none.

    It need not be exact: it only has to bring most of the image within reach of the flow.
    """
    import cv2

    good = _good_matches(a.descriptors, b.descriptors)
    if len(good) < 12:
        return np.eye(3)
    source = a.points[[match.queryIdx for match in good]]
    target = b.points[[match.trainIdx for match in good]]
    warp, inliers = cv2.findHomography(source, target, cv2.RANSAC, 8.0)
    height, width = a.labels.shape
    corners = np.array([[[0, 0], [width, 0], [0, height], [width, height]]], np.float64)
    if warp is None or inliers.sum() < 12:
        return np.eye(3)
    # A corner at or behind the horizon, or far away, marks a fit to accidental matches.
    weights = corners[0] @ warp[2, :2] + warp[2, 2]
    if weights.min() < 0.2 or weights.max() > 5:
        return np.eye(3)
    return warp


def _good_matches(a: np.ndarray | None, b: np.ndarray | None) -> list:
    """OpenCV's matches of SIFT descriptors that are clearly better than the second best."""
    import cv2

    if a is None or b is None or len(b) < 2:
        return []
    pairs = cv2.BFMatcher().knnMatch(a, b, k=2)
    return [best for best, second in pairs if best.distance < 0.8 * second.distance]


def _flow(a: np.ndarray, b: np.ndarray, warp: np.ndarray) -> np.ndarray:
    """Where every pixel of ``a`` lies in ``b``, float32 [H, W, 2] (x, y): ``warp``, then DIS."""
    import cv2

    grid = pixel_grid(a.shape)
    ahead = cv2.perspectiveTransform(grid.reshape(1, -1, 2), warp).reshape(grid.shape)
    warped = cv2.remap(b, ahead, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(a, warped, None)
    return cv2.perspectiveTransform((grid + flow).reshape(1, -1, 2), warp).reshape(grid.shape)
