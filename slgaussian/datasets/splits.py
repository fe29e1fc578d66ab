"""Split of clips by place into train and test; an assignment never moves.

``places.parquet`` (spec ``places``) in a training set, in a folder of lessons or of versions of
weights has the place and side of every clip that it ever had. It decides for these clips; the hash
of a place's name decides for new places.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from slgaussian.datasets.scene_grouping import Places
from slgaussian.errors import InputError
from slgaussian.kernels.seeding import held_out, seed_for
from slgaussian.storage.encoding import load_table, save_table
from slgaussian.storage.specs import load_spec

FILE = "places.parquet"
TRAIN, TEST = SPLITS = ("train", "test")


@dataclass(frozen=True, eq=False)
class Split:
    """Sides of the clips of a run.

    Attributes:
        table: Spec ``places``, of these clips and of all from before.
        sides: {clip: train or test} of the clips that may be used.
        left_out: {clip: reason} of the others: those of a place that was on both sides.
        places: {clip: place} of both.
        new: Number of clips that were assigned by this run.
    """

    table: pa.Table
    sides: dict[str, str]
    left_out: dict[str, str]
    places: dict[str, str]
    new: int

    def write(self, folder: Path) -> None:
        """Write the table to a folder; OSError if that fails."""
        save_table(folder / FILE, self.table, "places")

    @property
    def digest(self) -> str:
        """SHA-256 of the names of the test clips, the first 16 hexadecimal digits."""
        tests = sorted(clip for clip, side in self.sides.items() if side == TEST)
        return hashlib.sha256("\n".join(tests).encode()).hexdigest()[:16]

    @property
    def summary(self) -> str:
        """The numbers of clips and places, and why clips were joined, as text."""
        sides = {self.places[clip]: side for clip, side in self.sides.items()}
        reasons = Counter(
            row["why"] for row in self.table.to_pylist() if row["clip"] in self.places
        )
        alone = reasons.pop("alone", 0)
        joined = "".join(f", joined {count} by {why}" for why, count in sorted(reasons.items()))
        first = "".join(f", as {reason}" for reason in list(self.left_out.values())[:1])
        return (
            f"places: {len(set(self.places.values()))}, held out {Counter(sides.values())[TEST]}; "
            f"clips: {len(self.places)}, new {self.new}, alone {alone}{joined}, left out "
            f"{len(self.left_out)}{first}"
        )


def read_split(*folders: Path) -> list[dict[str, Any]]:
    """Read the rows of ``places.parquet`` of folders, where they have one.

    A clip that one of them has on the side of train is there, as something has learnt it.
    """
    rows: dict[str, dict[str, Any]] = {}
    for file in (folder / FILE for folder in folders):
        if file.is_file():
            repair = "restore it from a copy: without it, clips may change their side"
            for row in load_table(file, "places", repair).to_pylist():
                before = rows.setdefault(row["clip"], row)
                if row["split"] == TRAIN:
                    rows[row["clip"]] = {**before, "split": TRAIN}
    return list(rows.values())


def assign_split(
    places: Places,
    clips: Collection[str],
    fraction: float,
    recorded: Sequence[Mapping[str, Any]],
    winner: str,
) -> Split:
    """Assign places to train and test.

    A place is on the side of its recorded clips; a new one, of which there is no such clip, by the
    hash of its name. If no place would be held out, one of several new ones is. Clips that were on
    two sides and show one place, as a later clip or name tells, are all on the side ``winner``;
    those recorded on the other are left out. For training sets it is ``test``: what was
    held out stays so, and what may have been learnt is not moved there. For trainings it
    is ``train``: what weights have learnt never judges them.

    Args:
        places: Of these clips; the recorded ones are added.
        clips: Those that have samples.
        fraction: Expected fraction of test places, in [0, 1].
        recorded: Rows of spec ``places`` from before, at least clip, place and split.

    Raises:
        InputError: If the views of a clip are missing.
    """
    known = {row["clip"]: row for row in recorded}
    for clip, row in known.items():
        places.record(clip, row["place"])
    members = places.by_clip()
    if missing := set(clips) - members.keys():
        raise InputError(
            f"clip {min(missing)!r}: found samples, but no view of it, so its place is not known; "
            "run `slgaussian supervise` again"
        )
    before = defaultdict[str, dict[str, str]](dict)  # first clip of each side by place
    for clip in sorted(known):
        before[members[clip].place].setdefault(known[clip]["split"], clip)
    sides: dict[str, str] = {}
    for place in sorted({members[clip].place for clip in clips}):
        recorded_sides = set(before[place]) or {SPLITS[held_out(place, fraction)]}
        sides[place] = winner if len(recorded_sides) > 1 else recorded_sides.pop()
    new = [place for place in sides if not before[place]]
    if fraction and new and len(sides) > 1 and TEST not in sides.values():
        sides[min(new, key=lambda place: seed_for(0, place, "held out"))] = TEST
    rows, usable, left_out = [], dict[str, str](), dict[str, str]()
    for clip in sorted({*clips, *known}):
        member = members[clip]
        split = known[clip]["split"] if clip in known else sides[member.place]
        row = {"clip": clip, "place": member.place, "split": split}
        rows.append({**row, "why": member.why, "other": member.other})
        if clip not in clips:
            continue
        if split == sides[member.place]:
            usable[clip] = split
        else:
            rival = before[member.place][winner]
            left_out[clip] = (
                f"clip {clip!r} was assigned to {split}, but shows one place with {rival!r}, which "
                f"was assigned to {winner} ({member.why}); it is left out of both"
            )
    of_clips = {clip: members[clip].place for clip in clips}
    table = pa.Table.from_pylist(rows, schema=load_spec("places").schema)
    return Split(table, usable, left_out, of_clips, len(set(clips) - known.keys()))
