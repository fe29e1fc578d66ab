"""Group clips by place: training and test samples must not share a place.

Known is what the user says, which video a clip is from, and which clips share a photograph, as the
same bytes, as a near copy (another quality, size, brightness or a modest crop), or under the same
cameras. Not known, and so left to the user (``PLACE=SOURCE``), are two recordings of one place that
share no view, copies that are mirrored, turned or cropped by more than a seventh, and worlds: poses
of two clips may be in one frame of reference without saying so, and those of unrelated rooms are
equal where a rig or a program made them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from slgaussian.copies import normalise
from slgaussian.datasets.near_copies import find_copies, stack_signatures
from slgaussian.errors import InputError
from slgaussian.storage.encoding import load_table

RECORDED, NAMED, VIDEO, CLIP = range(4)
"""Sources of the name of a place, in order of priority."""

REASONS = ("named", "video", "bytes", "near copy", "recorded", "alone")
"""Why a clip belongs to its place, in order of priority: by the user's name; by its video; by equal
bytes or a near copy of a photograph of the other clip; as it was recorded, for a reason that is
gone; or it has a place of its own."""

VIEW_COLUMNS = ("clip", "place", "video", "frame", "digest", "signature")
"""Columns of spec ``views`` that tell places."""


@dataclass(frozen=True)
class Membership:
    """Place of a clip, and why: one of :data:`REASONS`, with the ``other`` clip, if there is."""

    place: str
    why: str = "alone"
    other: str | None = None


class Places:
    """Incremental grouping of clips into places.

    A place has its recorded name, else the user's, else that of its video, else of its first clip
    in the order of names. So its name is stable when clips are added, unless these join it with
    another place.
    """

    def __init__(self) -> None:
        self._joined = DisjointSet()
        self._reasons: dict[str, Membership] = {}
        self._first: dict[Any, str] = {}  # first clip of a name, a video or a photograph
        self._recorded: dict[str, str] = {}
        self._signatures: list[tuple[str, bytes]] = []  # each with its clip

    def add_views(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add clips by their rows of spec ``views``, those of a clip one after the other."""
        for clip, group in groupby(rows, key=lambda row: row["clip"]):
            views = list(group)
            self._joined.add((CLIP, clip))
            self._share((NAMED, views[0]["place"]), clip, "named")
            for video in {view["video"] for view in views}:
                self._share((VIDEO, video), clip, "video")
            data = [bytes.fromhex(view["signature"]) for view in views]
            shows_something = np.atleast_1d(normalise(stack_signatures(data)).any(1))
            for view, signature, shows in zip(views, data, shows_something, strict=True):
                if shows:  # black frames are alike in all videos
                    # The first 16 of 64 digits suffice: no collision is expected in ten million.
                    self._share(int(view["digest"][:16], 16), clip, "bytes")
                    self._signatures.append((clip, signature))

    def record(self, clip: str, place: str) -> None:
        """Add the place of a clip as it was recorded before; empty if it was not."""
        self._joined.add((CLIP, clip))
        self._recorded[clip] = place

    def by_clip(self) -> dict[str, Membership]:
        """Return the place of every clip, and why it belongs there."""
        if self._signatures:
            owners, data = zip(*self._signatures, strict=True)
            clips = {clip: number for number, clip in enumerate(dict.fromkeys(owners))}
            roots = [repr(self._joined[CLIP, clip]) for clip in clips]
            numbers = np.array([clips[clip] for clip in owners])
            groups = np.unique(roots, return_inverse=True)[1]
            for first, second in find_copies(stack_signatures(data), numbers, groups[numbers]):
                self._join(owners[first], owners[second], "near copy")
        for clip, place in self._recorded.items():
            self._share((RECORDED, place), clip, "recorded")
        result = {}
        for subset in self._joined.subsets():
            place = min(subset)[1]
            for kind, clip in subset:
                if kind == CLIP:
                    result[clip] = replace(self._reasons.get(clip, Membership("")), place=place)
        return result

    def _share(self, thing: int | tuple[int, str | None], clip: str, why: str) -> None:
        """Join a clip with the first clip of a photograph, a name or a video, if it has one."""
        if isinstance(thing, tuple):
            if not thing[1]:
                return
            self._joined.add(thing)
            self._joined.merge(thing, (CLIP, clip))
        first = self._first.setdefault(thing, clip)
        if first != clip:
            self._join(first, clip, why)

    def _join(self, first: str, second: str, why: str) -> None:
        self._joined.merge((CLIP, first), (CLIP, second))
        for clip, other in ((first, second), (second, first)):
            before = self._reasons.get(clip)
            if before is None or REASONS.index(why) < REASONS.index(before.why):
                self._reasons[clip] = Membership("", why, other)


def read_views(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table of spec ``views``; InputError if it is missing."""
    if not file.is_file():
        raise InputError(
            f"{file}: is missing, so nothing tells which clips show one place; run `slgaussian "
            "supervise` again, which writes it"
        )
    table = load_table(file, "views", "run `slgaussian supervise` again")
    for batch in table.select(VIEW_COLUMNS).to_batches(max_chunksize=10_000):
        yield from batch.to_pylist()
