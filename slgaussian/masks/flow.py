"""The tracker that needs no weights: dense optical flow and an appearance memory."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slgaussian.errors import InputError
from slgaussian.masks.boundaries import lab_of
from slgaussian.masks.merge import adjacency
from slgaussian.masks.regions import check_image, watershed_leaves
from slgaussian.scene import View

AGREE_PIXELS = 2.0
AGREE_SHARE = 0.05
"""Forward and backward flow may disagree by the pixels, or by this share of the motion."""
LOOK = 25.0
"""CIELAB distance at which matched pixels do not show the same thing, exposure aside."""
SEEN = 0.3
"""Share of a leaf that must have a match before flow decides its label."""
LIKE = 0.6
"""Share of a leaf that must wear the colours of an object before the object grows over it."""
COMMON = 0.01
"""A colour bin belongs to an object that has at least this share of its pixels there."""
COLOR_BINS = (10, 10, 10)


@dataclass(frozen=True, eq=False)
class _Frame:
    image: np.ndarray
    lab: np.ndarray
    gray: np.ndarray
    points: np.ndarray
    descriptors: np.ndarray | None
    labels: np.ndarray


class FlowTracker:
    """Carries labels to a new view by dense flow, checked both ways, and by colour.

    Every remembered frame is matched with the new one: SIFT matches give a homography, the image
    warped by it gives DIS flow (Kroeger et al. 2016) small enough to find, so that steps of a
    hundred pixels are followed. Small watershed leaves of the new view, not pixels, take the
    majority of the labels that flow brings, which keeps borders on image edges. Leaves without a
    match, occluded or outside the old view, take a neighbour's label if they wear that object's
    colours, as remembered from all frames; the rest stays 0.

    The same memory and view give the same labels, whatever the number of threads. A view whose
    image equals a remembered one has zero flow: it gets that frame's labels back (the latest such
    frame's), exactly.
    """

    def __init__(self) -> None:
        self._frames: list[_Frame] = []

    def add(self, view: View, labels: np.ndarray) -> None:
        """Remember a frame; see :class:`slgaussian.masks.MaskTracker`.

        Raises
        ------
        InputError
            If the labels are not int32 of the view's size, or frames differ in size.
        """
        self._check_size(view)
        if labels.dtype != np.int32 or labels.shape != view.image.shape[:2]:
            raise InputError(
                f"view {view.name!r}: labels are {labels.dtype} {labels.shape}, expected int32 "
                f"{view.image.shape[:2]}"
            )
        if labels.min() < 0:
            raise InputError(f"view {view.name!r}: negative label {labels.min()}; ids start at 1")
        self._frames.append(_describe(view.image, labels.copy()))

    def propagate(self, view: View) -> np.ndarray:
        """Labels int32 [H, W] for ``view``; see :class:`slgaussian.masks.MaskTracker`."""
        self._check_size(view)
        for frame in reversed(self._frames):
            if np.array_equal(frame.image, view.image):
                return frame.labels.copy()
        labels = np.zeros(view.image.shape[:2], np.int32)
        if not any(frame.labels.any() for frame in self._frames):
            return labels
        new = _describe(view.image, labels)
        leaves = watershed_leaves(_gradient(new.lab))
        size = np.bincount(leaves.ravel())
        top = max(int(frame.labels.max()) for frame in self._frames) + 1
        votes = np.zeros((len(size), top))
        seen = np.zeros(labels.shape, bool)
        for frame in self._frames:
            carried, matched = _carry(new, frame)
            keys = leaves[matched].astype(np.int64) * top + carried[matched]
            votes += np.bincount(keys, minlength=votes.size).reshape(votes.shape)
            seen |= matched
        seen_share = np.bincount(leaves.ravel(), seen.ravel(), len(size)) / size
        of_leaf = np.where(seen_share >= SEEN, votes.argmax(1), 0).astype(np.int32)
        self._grow(of_leaf, leaves, new.lab, top)
        return of_leaf[leaves]

    def _check_size(self, view: View) -> None:
        check_image(view.image)
        if self._frames and self._frames[0].image.shape != view.image.shape:
            raise InputError(
                f"view {view.name!r}: image is {view.image.shape}, remembered frames are "
                f"{self._frames[0].image.shape}; all views of a sequence must have one size"
            )

    def _grow(self, of_leaf: np.ndarray, leaves: np.ndarray, lab: np.ndarray, top: int) -> None:
        """Let objects grow, in place, over unlabelled leaves that wear their colours."""
        bins = int(np.prod(COLOR_BINS))
        worn = np.zeros((top, bins))
        for frame in self._frames:
            keys = frame.labels.astype(np.int64) * bins + _color_bins(frame.lab)
            worn += np.bincount(keys.ravel(), minlength=worn.size).reshape(worn.shape)
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


def _describe(image: np.ndarray, labels: np.ndarray) -> _Frame:
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    sift = cv2.SIFT_create(nfeatures=1500, contrastThreshold=0.02)
    keypoints, descriptors = sift.detectAndCompute(gray, None)
    points = np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2)
    lab = cv2.GaussianBlur(lab_of(image), (0, 0), 1.0)
    return _Frame(image, lab, gray, points, descriptors, labels)


def _carry(new: _Frame, old: _Frame) -> tuple[np.ndarray, np.ndarray]:
    """Labels of ``old`` seen from ``new``, int32 [H, W], and where a match was found, bool."""
    warp = _homography(new, old)
    there = _match(new.gray, old.gray, warp)
    back = _match(old.gray, new.gray, np.linalg.inv(warp))
    grid = _grid(new.gray.shape)
    height, width = new.gray.shape
    columns, rows = np.rint(there[..., 0]), np.rint(there[..., 1])
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    columns = np.where(inside, columns, 0).astype(np.int64)
    rows = np.where(inside, rows, 0).astype(np.int64)
    error = np.linalg.norm(back[rows, columns] - grid, axis=-1)
    motion = np.linalg.norm(there - grid, axis=-1)
    matched = inside & (error <= np.maximum(AGREE_PIXELS, AGREE_SHARE * motion))
    if matched.any():
        gap = new.lab - old.lab[rows, columns]
        gap -= np.median(gap[matched], 0)  # another exposure or white balance is no other object
        matched &= np.linalg.norm(gap, axis=-1) < LOOK
    return old.labels[rows, columns], matched


def _homography(a: _Frame, b: _Frame) -> np.ndarray:
    """The homography float64 [3, 3] that most SIFT matches follow; the identity if there is none.

    It need not be exact: it only has to bring most of the image within reach of the flow.
    """
    if min(len(a.points), len(b.points)) < 2:
        return np.eye(3)
    pairs = cv2.BFMatcher().knnMatch(a.descriptors, b.descriptors, k=2)
    good = [best for best, second in pairs if best.distance < 0.8 * second.distance]
    if len(good) < 12:
        return np.eye(3)
    source = a.points[[match.queryIdx for match in good]]
    target = b.points[[match.trainIdx for match in good]]
    warp, inliers = cv2.findHomography(source, target, cv2.RANSAC, 8.0)
    height, width = a.gray.shape
    corners = np.array([[[0, 0], [width, 0], [0, height], [width, height]]], np.float64)
    if warp is None or inliers.sum() < 12:
        return np.eye(3)
    # A corner at or behind the horizon, or far away, marks a fit to accidental matches.
    weights = corners[0] @ warp[2, :2] + warp[2, 2]
    if weights.min() < 0.2 or weights.max() > 5:
        return np.eye(3)
    return warp


def _match(a: np.ndarray, b: np.ndarray, warp: np.ndarray) -> np.ndarray:
    """Where every pixel of ``a`` lies in ``b``, float32 [H, W, 2] (x, y): ``warp``, then DIS."""
    grid = _grid(a.shape)
    ahead = cv2.perspectiveTransform(grid.reshape(1, -1, 2), warp).reshape(grid.shape)
    warped = cv2.remap(b, ahead, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(a, warped, None)
    return cv2.perspectiveTransform((grid + flow).reshape(1, -1, 2), warp).reshape(grid.shape)


def _grid(size: tuple[int, int]) -> np.ndarray:
    """Column and row of every pixel, float32 [H, W, 2]."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32)
    return np.stack([columns, rows], -1)


def _gradient(lab: np.ndarray) -> np.ndarray:
    """Length of the CIELAB gradient, float32 [H, W]."""
    dx, dy = cv2.Sobel(lab, cv2.CV_32F, 1, 0), cv2.Sobel(lab, cv2.CV_32F, 0, 1)
    return np.sqrt((dx**2 + dy**2).sum(-1))


def _color_bins(lab: np.ndarray) -> np.ndarray:
    """Joint CIELAB bin of every pixel, int64 [H, W], under ``prod(COLOR_BINS)``."""
    chroma = np.sign(lab[..., 1:]) * np.sqrt(np.abs(lab[..., 1:])) + COLOR_BINS[1] / 2
    steps = (lab[..., 0] / 10, chroma[..., 0], chroma[..., 1])
    bins = [np.clip(s, 0, n - 1).astype(np.int64) for s, n in zip(steps, COLOR_BINS, strict=True)]
    return np.ravel_multi_index(bins, COLOR_BINS)
