"""The tracker ``geometric``: labels reprojected through predicted depth and snapped to segments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.masks.shared import SurfacePoints, match_points, overlap

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView

MIN_MATCHED_SHARE = 0.3
"""Smallest fraction of matched pixels at which matches determine the label of a leaf."""
MIN_COLOUR_SHARE = 0.6
"""Smallest fraction of a leaf in the colours of an object at which the object grows over it."""
MIN_BIN_SHARE = 0.01
"""Smallest fraction of an object's pixels in a colour bin at which the object has that colour."""
COLOUR_BINS = (10, 10, 10)
MAX_FRAMES = 6
"""Largest number of remembered frames, those with the greatest overlap, that a view is matched
with."""


@dataclass(frozen=True, eq=False)
class LabelledFrame(SurfacePoints):
    """A view with its labels.

    Attributes:
        labels: int32 [H, W]. 0 = unassigned.
    """

    labels: np.ndarray

    @cached_property
    def lab(self) -> np.ndarray:
        """CIELAB float32 [H, W, 3] of the slightly blurred image."""
        import cv2

        return cv2.GaussianBlur(self.frame.view.lab, (0, 0), 1.0)


class GeometricTracker:
    """Propagates labels from remembered frames to a view by cameras and predicted depth.

    Pixels of the view are matched with those of remembered frames by depth and colour
    (:func:`slgaussian.masks.shared.match_points`). Labels are assigned to the watershed leaves of
    the view by majority of their matched pixels, so that label borders lie on image edges. A leaf
    without matches takes the label of a neighbour if it has that object's colours in all remembered
    frames; other leaves stay 0. A view whose image equals a remembered one gets the labels of the
    latest such frame exactly.
    """

    final: ClassVar[bool] = False
    repeatable: ClassVar[bool] = True

    def __init__(self) -> None:
        self._frames: list[LabelledFrame] = []
        self._colour_counts = np.zeros((1, int(np.prod(COLOUR_BINS))))

    def add(self, frame: SeenView, labels: np.ndarray) -> None:
        """Remember a frame with depth; see :class:`slgaussian.masks.MaskTracker`."""
        labelled = LabelledFrame(frame, labels.copy())
        self._frames.append(labelled)
        new_ids = int(labels.max()) + 1 - len(self._colour_counts)
        self._colour_counts = np.pad(self._colour_counts, ((0, max(new_ids, 0)), (0, 0)))
        bins = self._colour_counts.shape[1]
        keys = labels.astype(np.int64) * bins + _colour_bins(labelled.lab)
        counts = np.bincount(keys.ravel(), minlength=self._colour_counts.size)
        self._colour_counts += counts.reshape(-1, bins)

    def propagate(self, frame: SeenView) -> np.ndarray:
        """Return labels int32 [H, W] of a view; see :class:`slgaussian.masks.MaskTracker`."""
        from slgaussian.masks.segmentation import watershed_leaves

        for past in reversed(self._frames):
            if np.array_equal(past.frame.image, frame.image):
                return past.labels.copy()
        labels = np.zeros(frame.image.shape[:2], np.int32)
        new = LabelledFrame(frame, labels)
        if not any(past.labels.any() for past in self._frames):
            return labels
        leaves = watershed_leaves(_gradient(new.lab))
        size = np.bincount(leaves.ravel())
        id_count = max(int(past.labels.max()) for past in self._frames) + 1
        votes = np.zeros((len(size), id_count))
        matched_once, all_pixels = np.zeros(labels.shape, bool), new.pixels(1)
        for past in self._nearest(new):
            which, place = match_points(new, past, all_pixels)
            pixels = all_pixels[which]
            past_labels = past.labels.ravel()[place]
            keys = leaves.ravel()[pixels].astype(np.int64) * id_count + past_labels
            votes += np.bincount(keys, minlength=votes.size).reshape(votes.shape)
            matched_once.ravel()[pixels] = True
        matched_share = np.bincount(leaves.ravel(), matched_once.ravel(), len(size)) / size
        of_leaf = np.where(matched_share >= MIN_MATCHED_SHARE, votes.argmax(1), 0).astype(np.int32)
        self._grow(of_leaf, leaves, new.lab, id_count)
        return of_leaf[leaves]

    def _nearest(self, new: LabelledFrame) -> list[LabelledFrame]:
        """Return the remembered frames with the greatest overlap, in order of their addition."""
        if len(self._frames) <= MAX_FRAMES:
            return self._frames
        points = SurfacePoints(new.frame)
        overlaps = [overlap(points, SurfacePoints(past.frame)) for past in self._frames]
        best = np.argsort(-np.array(overlaps), kind="stable")[:MAX_FRAMES]
        return [self._frames[k] for k in np.sort(best)]

    def _grow(
        self, of_leaf: np.ndarray, leaves: np.ndarray, lab: np.ndarray, id_count: int
    ) -> None:
        """Grow objects, in place, over unlabelled neighbouring leaves with their colours."""
        from slgaussian.masks.merge import adjacency

        counts, bins = self._colour_counts, self._colour_counts.shape[1]
        object_bins = counts >= MIN_BIN_SHARE * counts.sum(1, keepdims=True).clip(1)
        keys = leaves.astype(np.int64) * bins + _colour_bins(lab)
        leaf_colours = np.bincount(keys.ravel(), minlength=len(of_leaf) * bins)
        leaf_colours = leaf_colours.reshape(len(of_leaf), bins)
        edges, borders = adjacency(leaves, np.zeros(leaves.shape, np.float32))
        edges = np.concatenate([edges, edges[:, ::-1]])
        length = np.tile(borders[:, 0], 2)
        while True:
            front = (of_leaf[edges[:, 0]] == 0) & (of_leaf[edges[:, 1]] > 0)
            leaf, label = edges[front, 0], of_leaf[edges[front, 1]]
            similarity = (leaf_colours[leaf] * object_bins[label]).sum(1) / leaf_colours[leaf].sum(
                1
            )
            wins = similarity >= MIN_COLOUR_SHARE
            if not wins.any():
                return
            border = np.zeros((len(of_leaf), id_count))
            weights = similarity[wins] * length[front][wins]
            np.add.at(border, (leaf[wins], label[wins]), weights)
            grown = np.unique(leaf[wins])
            of_leaf[grown] = border[grown].argmax(1)


def _gradient(lab: np.ndarray) -> np.ndarray:
    """Compute the magnitude of the CIELAB gradient, float32 [H, W]."""
    import cv2

    dx, dy = cv2.Sobel(lab, cv2.CV_32F, 1, 0), cv2.Sobel(lab, cv2.CV_32F, 0, 1)
    squares = dx**2 + dy**2
    return np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])


def _colour_bins(lab: np.ndarray) -> np.ndarray:
    """Return the joint CIELAB bin of every pixel, int64 [H, W], below ``prod(COLOUR_BINS)``."""
    chroma = np.sign(lab[..., 1:]) * np.sqrt(np.abs(lab[..., 1:])) + COLOUR_BINS[1] / 2
    steps = (lab[..., 0] / 10, chroma[..., 0], chroma[..., 1])
    bins = [np.clip(s, 0, n - 1).astype(np.int64) for s, n in zip(steps, COLOUR_BINS, strict=True)]
    return np.ravel_multi_index(bins, COLOUR_BINS)
