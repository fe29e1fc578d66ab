"""Group clips by place: training and test samples must not share a place."""

from __future__ import annotations

from collections.abc import Iterable

from scipy.cluster.hierarchy import DisjointSet

NAMED, VIDEO, CLIP = range(3)  # sources of the name of a place, in order of priority


class Places:
    """Incremental grouping of clips into places.

    Clips show one place if the user says so, if they are from one video, or if they share a
    photograph, byte for byte. A place is named by the user's name, else by its video, else by its
    first clip in the order of names. So its name, and its side of a split by name, are stable when
    clips are added, unless these join it with another place.
    """

    def __init__(self) -> None:
        self._joined = DisjointSet()
        self._clip_of_photograph: dict[int, tuple[int, str]] = {}

    def add(self, clip: str, photographs: Iterable[str] = (), place: str = "") -> None:
        """Add a clip with the SHA-256 of its photographs and, if the user gave it, its place."""
        node = (CLIP, clip)
        self._join(node, (NAMED, place) if place else node)
        for digest in photographs:
            # The first 16 of 64 digits suffice: no collision is expected in ten million.
            self._join(node, self._clip_of_photograph.setdefault(int(digest[:16], 16), node))

    def seen_in(self, clip: str, url: str) -> None:
        """Add the video of a clip, if there is one."""
        if url:
            self._join((CLIP, clip), (VIDEO, url))

    def by_clip(self) -> dict[str, str]:
        """Return the name of the place of every clip."""
        return {
            name: min(subset)[1]
            for subset in self._joined.subsets()
            for kind, name in subset
            if kind == CLIP
        }

    def _join(self, first: tuple[int, str], second: tuple[int, str]) -> None:
        self._joined.add(first)
        self._joined.add(second)
        self._joined.merge(first, second)
