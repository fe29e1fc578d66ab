"""Group clips by place: training and test samples must not share a place."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

KINDS = ("said", "video", "clip")
"""Sources of the name of a place, in order of priority."""


class Places:
    """Incremental grouping of clips into places (union-find).

    Clips show one place if the user says so, if they are from one video, or if they share a
    photograph, byte for byte. A place is named by the user's name, else by its video, else by its
    first clip in the order of names. So its name, and its side of a split by name, are stable when
    clips are added, unless these join it with another place.
    """

    def __init__(self) -> None:
        self._nodes: dict[tuple[str, str], int] = {}
        self._joined: list[tuple[int, int]] = []
        self._photographs: list[np.ndarray] = []
        self._owners: list[np.ndarray] = []

    def add(self, clip: str, photographs: Iterable[str] = (), place: str = "") -> None:
        """Add a clip with the SHA-256 of its photographs and, if the user gave it, its place."""
        node = self._node("clip", clip)
        # The first 16 of 64 digits suffice: no collision is expected in ten million photographs.
        digests = np.array([int(digest[:16], 16) for digest in photographs], np.uint64)
        self._photographs.append(digests)
        self._owners.append(np.full(len(digests), node))
        if place:
            self._joined.append((node, self._node("said", place)))

    def seen_in(self, clip: str, url: str) -> None:
        """Add the video of a clip, if there is one."""
        if url:
            self._joined.append((self._node("clip", clip), self._node("video", url)))

    def by_clip(self) -> dict[str, str]:
        """Return the name of the place of every clip."""
        count = len(self._nodes)
        if not count:
            return {}
        photographs = np.concatenate([np.zeros(0, np.uint64), *self._photographs])
        owners = np.concatenate([np.zeros(0, np.int64), *self._owners])
        order = np.argsort(photographs, kind="stable")
        same = photographs[order][1:] == photographs[order][:-1]
        sharing = np.stack([owners[order][1:][same], owners[order][:-1][same]])
        joined = np.concatenate([np.array(self._joined, np.int64).reshape(-1, 2).T, sharing], 1)
        graph = coo_matrix((np.ones(joined.shape[1]), joined), (count, count))
        _, place = connected_components(graph, directed=False)
        names: dict[int, tuple[int, str]] = {}
        for (kind, name), node in self._nodes.items():
            named = KINDS.index(kind), name
            names[place[node]] = min(names.get(place[node], named), named)
        clips = ((name, node) for (kind, name), node in self._nodes.items() if kind == "clip")
        return {clip: names[place[node]][1] for clip, node in clips}

    def _node(self, kind: str, name: str) -> int:
        return self._nodes.setdefault((kind, name), len(self._nodes))
