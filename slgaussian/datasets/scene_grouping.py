"""Group clips by place: training and test samples must not share a place."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.cluster.hierarchy import DisjointSet
from scipy.spatial import KDTree

from slgaussian.copies import normalise

NAMED, VIDEO, CLIP = range(3)  # sources of the name of a place, in order of priority

SIGNATURE_SIDE, MIN_COPY_CORRELATION = 16, 0.97
"""Side of signatures (:func:`slgaussian.copies.signature`), and the correlation from which on two
photographs show one place. It is .98 or more for copies of another quality, size or gamma, .96 with
a third more contrast, and .79 at most between 26 places. Crops of 2 % are missed at times; larger
ones, frames and turned copies always or mostly."""

REPEATED_CORRELATION = 0.998
"""Correlation from which on a frame adds nothing to the frame before it in its clip."""


class Places:
    """Incremental grouping of clips into places.

    Clips show one place if the user says so, if they are from one video, or if they share a
    photograph, byte for byte or as a near copy. A place is named by the user's name, else by its
    video, else by its first clip in the order of names. So its name, and its side of a split by
    name, are stable when clips are added, unless these join it with another place.
    """

    def __init__(self) -> None:
        self._joined = DisjointSet()
        self._clip_of_photograph: dict[int, tuple[int, str]] = {}
        self._signatures: list[tuple[tuple[int, str], np.ndarray]] = []

    def add(
        self,
        clip: str,
        photographs: Iterable[str] = (),
        place: str = "",
        signatures: Iterable[str] = (),
    ) -> None:
        """Add a clip.

        Args:
            photographs: SHA-256 of its photographs, hexadecimal.
            place: Its place, if the user gave it.
            signatures: Those of its photographs, as in spec ``views``.
        """
        node = (CLIP, clip)
        self._join(node, (NAMED, place) if place else node)
        for digest in photographs:
            # The first 16 of 64 digits suffice: no collision is expected in ten million.
            self._join(node, self._clip_of_photograph.setdefault(int(digest[:16], 16), node))
        last: np.ndarray | None = None
        for text in signatures:
            values = np.frombuffer(bytes.fromhex(text), np.uint8)
            normal = normalise(values)
            if normal.any() and (last is None or normal @ last < REPEATED_CORRELATION):
                self._signatures.append((node, values))
                last = normal

    def seen_in(self, clip: str, url: str) -> None:
        """Add the video of a clip, if there is one."""
        if url:
            self._join((CLIP, clip), (VIDEO, url))

    def by_clip(self) -> dict[str, str]:
        """Return the name of the place of every clip."""
        self._join_copies()
        return {
            name: min(subset)[1]
            for subset in self._joined.subsets()
            for kind, name in subset
            if kind == CLIP
        }

    def _join_copies(self) -> None:
        """Join the clips of near copies, once for every photograph."""
        if not self._signatures:
            return
        nodes = [node for node, _ in self._signatures]
        normal = normalise(np.stack([values for _, values in self._signatures]))
        # Means of blocks, an orthogonal projection, are nearer to each other than the whole.
        blocks = normal.reshape(len(nodes), SIGNATURE_SIDE // 4, 4, SIGNATURE_SIDE // 4, 4)
        tree = KDTree(blocks.sum((2, 4)).reshape(len(nodes), -1) / 4)
        radius = (2 - 2 * MIN_COPY_CORRELATION) ** 0.5 + 1e-6
        for number, near in enumerate(tree.query_ball_point(tree.data, radius)):
            later = [k for k in near if k > number and nodes[k] != nodes[number]]
            for k, cosine in zip(later, normal[later] @ normal[number], strict=True):
                if cosine >= MIN_COPY_CORRELATION:
                    self._join(nodes[number], nodes[k])

    def _join(self, first: tuple[int, str], second: tuple[int, str]) -> None:
        self._joined.add(first)
        self._joined.add(second)
        self._joined.merge(first, second)
