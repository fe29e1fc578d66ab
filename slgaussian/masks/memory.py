"""What trackers without weights share: matched pixels vote on leaves, objects grow by colour."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from slgaussian.errors import InputError

if TYPE_CHECKING:
    from slgaussian.geometry import SeenView
    from slgaussian.scene import View

LOOK = 25.0
"""CIELAB distance at which matched pixels do not show the same thing, exposure aside."""
SEEN = 0.3
"""Share of a leaf that must have a match before matches decide its label."""
LIKE = 0.6
"""Share of a leaf that must wear the colours of an object before the object grows over it."""
COMMON = 0.01
"""A colour bin belongs to an object that has at least this share of its pixels there."""
COLOR_BINS = (10, 10, 10)
MOST_FRAMES = 6
"""Remembered frames that a new view is matched with: those that show most of it."""


@dataclass(frozen=True, eq=False)
class Frame:
    """What is known of a view: how it is seen and, once remembered, its labels.

    Attributes
    ----------
    seen : SeenView
    labels : int32 [H, W]
        0 = unassigned.
    lab : float32 [H, W, 3]
        CIELAB of the slightly blurred image.
    """

    seen: SeenView
    labels: np.ndarray
    lab: np.ndarray


class MemoryTracker(ABC):
    """Carries labels from remembered frames to a new one, given where their pixels match.

    Small watershed leaves of the new view, not pixels, take the majority of the labels that matched
    pixels bring, which keeps borders on image edges. Leaves without a match, occluded or outside
    the old views, take a neighbour's label if they wear that object's colours, as remembered from
    all frames; the rest stays 0.

    Only the frames that show most of a view are matched with it, so that many views cost a matching
    each a few times, and not each with all before it.

    The same memory and view give the same labels, whatever the number of threads. A view whose
    image equals a remembered one gets that frame's labels back (the latest such frame's), exactly.
    """

    final: ClassVar[bool] = False
    repeatable: ClassVar[bool] = True

    def __init__(self) -> None:
        self._frames: list[Frame] = []
        self._worn = np.zeros((1, int(np.prod(COLOR_BINS))))

    @abstractmethod
    def match(self, new: Frame, old: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Find the pixels of ``new`` in ``old``.

        Returns
        -------
        place : int64 [H, W]
            Index of the matching pixel in the flat old image; anything inside it where there is
            none.
        matched : bool [H, W]
        """

    @abstractmethod
    def shows(self, new: Frame, old: Frame) -> float:
        """How much of ``new`` the frame ``old`` shows, at little cost; the more the larger."""

    def add(self, seen: SeenView, labels: np.ndarray) -> None:
        """Remember a frame; see :class:`slgaussian.masks.MaskTracker`.

        Raises
        ------
        InputError
            If labels or depth have the wrong type or size, or a label is negative.
        """
        check_labels(seen.view, labels)
        frame = self.describe(seen, labels.copy())
        self._frames.append(frame)
        more = int(labels.max()) + 1 - len(self._worn)
        self._worn = np.pad(self._worn, ((0, max(more, 0)), (0, 0)))
        bins = self._worn.shape[1]
        keys = labels.astype(np.int64) * bins + _color_bins(frame.lab)
        self._worn += np.bincount(keys.ravel(), minlength=self._worn.size).reshape(-1, bins)

    def propagate(self, seen: SeenView) -> np.ndarray:
        """Labels int32 [H, W] for a view; see :class:`slgaussian.masks.MaskTracker`."""
        from slgaussian.masks.segmentation import watershed_leaves

        for frame in reversed(self._frames):
            if np.array_equal(frame.seen.image, seen.image):
                return frame.labels.copy()
        labels = np.zeros(seen.image.shape[:2], np.int32)
        new = self.describe(seen, labels)
        if not any(frame.labels.any() for frame in self._frames):
            return labels
        leaves = watershed_leaves(_gradient(new.lab))
        size = np.bincount(leaves.ravel())
        top = max(int(frame.labels.max()) for frame in self._frames) + 1
        votes = np.zeros((len(size), top))
        met = np.zeros(labels.shape, bool)
        for frame in self._nearest(new):
            place, matched = self.match(new, frame)
            if matched.any():
                gap = new.lab - frame.lab.reshape(-1, 3)[place]
                # Another exposure or white balance is no other object.
                gap -= np.median(gap[matched], 0)
                light, red, yellow = (gap[..., k] ** 2 for k in range(3))
                matched = matched & (np.sqrt(light + red + yellow) < LOOK)
            carried = frame.labels.ravel()[place[matched]]
            keys = leaves[matched].astype(np.int64) * top + carried
            votes += np.bincount(keys, minlength=votes.size).reshape(votes.shape)
            met |= matched
        seen_share = np.bincount(leaves.ravel(), met.ravel(), len(size)) / size
        of_leaf = np.where(seen_share >= SEEN, votes.argmax(1), 0).astype(np.int32)
        self._grow(of_leaf, leaves, new.lab, top)
        return of_leaf[leaves]

    def _nearest(self, new: Frame) -> list[Frame]:
        """The remembered frames that show most of a view, in the order in which they came."""
        if len(self._frames) <= MOST_FRAMES:
            return self._frames
        shown = np.array([self.shows(new, frame) for frame in self._frames])
        return [self._frames[k] for k in np.sort(np.argsort(-shown, kind="stable")[:MOST_FRAMES])]

    def describe(self, seen: SeenView, labels: np.ndarray) -> Frame:
        """What :meth:`match` needs to know of a view."""
        import cv2

        view, depth = seen.view, seen.depth
        if depth is not None and depth.shape != view.image.shape[:2]:
            raise InputError(
                f"view {view.name!r}: depth is {depth.shape}, expected {view.image.shape[:2]}"
            )
        return Frame(seen, labels, cv2.GaussianBlur(view.lab, (0, 0), 1.0))

    def _grow(self, of_leaf: np.ndarray, leaves: np.ndarray, lab: np.ndarray, top: int) -> None:
        """Let objects grow, in place, over unlabelled leaves that wear their colours."""
        from slgaussian.masks.merge import adjacency

        worn, bins = self._worn, self._worn.shape[1]
        owns = worn >= COMMON * worn.sum(1, keepdims=True).clip(1)
        colors = _color_bins(lab)
        keys = leaves.astype(np.int64) * bins + colors
        colors_of = np.bincount(keys.ravel(), minlength=len(of_leaf) * bins)
        colors_of = colors_of.reshape(len(of_leaf), bins)
        edges, length, _ = adjacency(leaves, np.zeros(leaves.shape, np.float32))
        edges = np.concatenate([edges, edges[:, ::-1]])
        length = np.concatenate([length, length])
        while True:
            front = (of_leaf[edges[:, 0]] == 0) & (of_leaf[edges[:, 1]] > 0)
            leaf, label = edges[front, 0], of_leaf[edges[front, 1]]
            like = (colors_of[leaf] * owns[label]).sum(1) / colors_of[leaf].sum(1)
            wins = like >= LIKE
            if not wins.any():
                return
            border = np.zeros((len(of_leaf), top))
            np.add.at(border, (leaf[wins], label[wins]), like[wins] * length[front][wins])
            grown = np.unique(leaf[wins])
            of_leaf[grown] = border[grown].argmax(1)


def check_labels(view: View, labels: np.ndarray) -> None:
    """Raise InputError unless ``labels`` are int32 of the size of ``view``, none negative."""
    if labels.dtype != np.int32 or labels.shape != view.image.shape[:2]:
        raise InputError(
            f"view {view.name!r}: labels are {labels.dtype} {labels.shape}, expected int32 "
            f"{view.image.shape[:2]}"
        )
    if labels.min() < 0:
        raise InputError(f"view {view.name!r}: negative label {labels.min()}; ids start at 1")


def _gradient(lab: np.ndarray) -> np.ndarray:
    """Length of the CIELAB gradient, float32 [H, W]."""
    import cv2

    dx, dy = cv2.Sobel(lab, cv2.CV_32F, 1, 0), cv2.Sobel(lab, cv2.CV_32F, 0, 1)
    squares = dx**2 + dy**2
    return np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2])


def _color_bins(lab: np.ndarray) -> np.ndarray:
    """Joint CIELAB bin of every pixel, int64 [H, W], under ``prod(COLOR_BINS)``."""
    chroma = np.sign(lab[..., 1:]) * np.sqrt(np.abs(lab[..., 1:])) + COLOR_BINS[1] / 2
    steps = (lab[..., 0] / 10, chroma[..., 0], chroma[..., 1])
    bins = [np.clip(s, 0, n - 1).astype(np.int64) for s, n in zip(steps, COLOR_BINS, strict=True)]
    return np.ravel_multi_index(bins, COLOR_BINS)


def both_ways(
    there: np.ndarray, back: np.ndarray, least: float, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Matches that lead back to where they came from, as :meth:`MemoryTracker.match` gives them.

    Parameters
    ----------
    there : float [H, W, 2]
        Where each pixel of the new frame lies in the old one: column and row, whole numbers at
        pixel centres; NaN where unknown.
    back : float [H', W', 2]
        Where each pixel of the old frame lies in the new one, likewise.
    least, share : float
        The way there and back may miss by ``least`` pixels, or by this share of the motion.
    """
    rows, columns = back.shape[:2]
    x, y = there[..., 0], there[..., 1]
    inside = (x > -0.5) & (y > -0.5) & (x < columns - 0.5) & (y < rows - 0.5)
    column, row = (np.rint(np.where(inside, axis, 0)).astype(np.int64) for axis in (x, y))
    place = row * columns + column
    start = [axis.astype(np.float32) for axis in np.ogrid[: there.shape[0], : there.shape[1]]]
    error = _length(*(axis[place] for axis in back.reshape(-1, 2).T), *start)
    motion = _length(x, y, *start)
    return place, inside & (error <= np.maximum(least, share * motion))


def _length(x: np.ndarray, y: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """How far ``x`` and ``y`` are from a column and row."""
    length: np.ndarray = np.sqrt((x - column) ** 2 + (y - row) ** 2)
    return length


def pixel_grid(size: tuple[int, int]) -> np.ndarray:
    """Column and row of every pixel, float32 [H, W, 2]."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32)
    return np.stack([columns, rows], -1)
