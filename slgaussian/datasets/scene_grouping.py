"""Group clips by place: training and test samples must not share a place.

Known is what the user says, which video a clip is from, and which clips share a photograph, as the
same bytes, as a near copy (another quality, size, brightness or a modest crop), or under the same
cameras. Not known, and so left to the user (``PLACE=SOURCE``), are two recordings of one place that
share no view, copies that are mirrored, turned or cropped by more than a seventh, and worlds: poses
of two clips may be in one frame of reference without saying so, and those of unrelated rooms are
alike where a rig or a program made them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from slgaussian.copies import normalise
from slgaussian.datasets.near_copies import (
    SIGNATURE_SIDE,
    align,
    find_copies,
    stack_signatures,
)
from slgaussian.errors import InputError
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.specs import load_spec

RECORDED, NAMED, VIDEO, CLIP = range(4)
"""Sources of the name of a place, in order of priority."""

NAME_REASONS = {RECORDED: "recorded", NAMED: "named", VIDEO: "video"}

REASONS = ("named", "video", "bytes", "near copy", "cameras", "recorded", "alone")
"""Why a clip belongs to its place, in order of priority: by the user's name; by its video; by equal
bytes, a near copy or equal cameras of a photograph of the other clip; as it was recorded, for a
reason that is gone; or it has a place of its own."""

MIN_EQUAL_CAMERAS, MAX_CLIPS_OF_CAMERA, MIN_ALIKE = 3, 16, 0.8
"""Two clips show one place if they have this many equal poses, and photographs there that are alike
(correlation once laid over each other). A pose of more clips, as that of a rig or the origin, is
not compared. Different rooms are alike up to .92, but have equal poses only by one rig."""

POSE_COLUMNS = tuple(f"w2c_{r}{c}" for r in range(3) for c in range(4))

VIEW_COLUMNS = ("clip", "place", "video", "frame", "digest", "signature", *POSE_COLUMNS)
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
        self._clips: dict[str, int] = {}
        self._reasons: dict[str, Membership] = {}
        self._first: dict[Any, str] = {}  # first clip of a name, a video or a photograph
        self._recorded: dict[str, str] = {}
        self._signatures: list[bytes] = []
        self._poses: list[int] = []
        self._of_signature: list[int] = []

    def add_views(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add clips by their rows of spec ``views``, those of a clip one after the other."""
        for clip, views in groupby(rows, key=lambda row: row["clip"]):
            self._add(clip, list(views))

    def record(self, clip: str, place: str) -> None:
        """Add the place of a clip as it was recorded before; empty if it was not."""
        self._joined.add((CLIP, clip))
        self._recorded[clip] = place

    def _add(self, clip: str, views: Sequence[Mapping[str, Any]]) -> None:
        self._joined.add((CLIP, clip))
        number = self._clips.setdefault(clip, len(self._clips))
        self._name(NAMED, views[0]["place"] or "", clip)
        for video in {view["video"] for view in views}:
            self._name(VIDEO, video, clip)
        data = [bytes.fromhex(view["signature"]) for view in views]
        normal = normalise(stack_signatures(data))
        for view, signature, values in zip(views, data, normal, strict=True):
            if not values.any():
                continue  # black frames are alike in all videos
            # The first 16 of 64 digits suffice: no collision is expected in ten million.
            self._share(int(view["digest"][:16], 16), clip, "bytes")
            self._signatures.append(signature)
            pose = tuple(round(view[name], 3) + 0.0 for name in POSE_COLUMNS)
            self._poses.append(hash(pose))
            self._of_signature.append(number)

    def by_clip(self) -> dict[str, Membership]:
        """Return the place of every clip, and why it belongs there."""
        self._join_copies()
        for clip, place in self._recorded.items():
            self._name(RECORDED, place, clip)
        result = {}
        for subset in self._joined.subsets():
            place = min(subset)[1]
            for kind, clip in subset:
                if kind == CLIP:
                    reason = self._reasons.get(clip, Membership(place))
                    result[clip] = Membership(place, reason.why, reason.other)
        return result

    def _name(self, kind: int, name: str, clip: str) -> None:
        """Join a clip with all clips of a name, unless it is empty."""
        if name:
            self._joined.add((kind, name))
            self._joined.merge((kind, name), (CLIP, clip))
            self._share((kind, name), clip, NAME_REASONS[kind])

    def _share(self, thing: Any, clip: str, why: str) -> None:
        """Join a clip with the first clip that has a name, a video or a photograph."""
        first = self._first.setdefault(thing, clip)
        if first != clip:
            self._join(first, clip, why)

    def _join(self, first: str, second: str, why: str) -> None:
        self._joined.merge((CLIP, first), (CLIP, second))
        for clip, other in ((first, second), (second, first)):
            before = self._reasons.get(clip)
            if before is None or REASONS.index(why) < REASONS.index(before.why):
                self._reasons[clip] = Membership("", why, other)

    def _join_copies(self) -> None:
        """Join the clips of near copies."""
        if not self._signatures:
            return
        clips = list(self._clips)
        of = np.array(self._of_signature)
        signatures = stack_signatures(self._signatures)
        for first, second in find_copies(signatures, of, self._groups()[of]):
            self._join(clips[of[first]], clips[of[second]], "near copy")
        for first, second in self._equal_cameras(signatures):
            self._join(clips[first], clips[second], "cameras")

    def _groups(self) -> np.ndarray:
        """Return a number for every clip, the same for clips that are joined, int [n]."""
        roots = [self._joined[CLIP, clip] for clip in self._clips]
        numbers = {root: number for number, root in enumerate(dict.fromkeys(roots))}
        return np.array([numbers[root] for root in roots])

    def _equal_cameras(self, signatures: np.ndarray) -> Iterator[tuple[int, int]]:
        """Yield pairs of clips with equal poses at which their photographs are alike."""
        by_pose = defaultdict[int, dict[int, int]](dict)
        for index, (pose, clip) in enumerate(zip(self._poses, self._of_signature, strict=True)):
            by_pose[pose].setdefault(clip, index)
        shared = defaultdict[tuple[int, int], list[tuple[int, int]]](list)
        groups = self._groups()
        for views in by_pose.values():
            if len(views) <= MAX_CLIPS_OF_CAMERA:
                for first, second in combinations(views, 2):
                    if groups[first] != groups[second]:
                        shared[first, second].append((views[first], views[second]))
        squares = signatures.reshape(-1, SIGNATURE_SIDE, SIGNATURE_SIDE).astype(np.float32)
        for pair, indices in shared.items():
            if len(indices) >= MIN_EQUAL_CAMERAS:
                a, b = squares[np.array(indices).T]
                if np.median(np.maximum(align(a, b), align(b, a))) >= MIN_ALIKE:
                    yield pair


def read_views(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table of spec ``views``; InputError if it is missing."""
    if not file.is_file():
        raise InputError(
            f"{file}: is missing, so nothing tells which clips show one place; run `slgaussian "
            "supervise` again, which writes it"
        )
    repair = "run `slgaussian supervise` again"
    table = decode_table(file.read_bytes(), load_spec("views"), str(file), repair)
    for batch in table.select(VIEW_COLUMNS).to_batches(max_chunksize=10_000):
        yield from batch.to_pylist()
