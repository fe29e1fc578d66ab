"""Check of what was written: no picture stands on both sides of a split.

It compares the pictures, and does not ask how places were assigned.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from slgaussian.copies import normalise, signature
from slgaussian.datasets.near_copies import SIGNATURE_SIDE, find_copies, stack_signatures
from slgaussian.datasets.shards import unpack
from slgaussian.datasets.sharpness import glance
from slgaussian.errors import InputError

SURE_CORRELATION = 0.985
"""Correlation of near copies that are refused. It is higher than that which joins clips
(:mod:`slgaussian.datasets.near_copies`), so that all between is joined, and never refused."""

IMAGES = (".jpg", ".png")


class Picture(NamedTuple):
    """A picture as it was written: its name for messages, clip, side, SHA-256 and signature."""

    name: str
    clip: str
    side: str
    digest: str
    signature: bytes


def check_pictures(pictures: Sequence[Picture], source: str) -> None:
    """Raise InputError if equal or nearly equal pictures are on two sides.

    Args:
        pictures: Those of a clip follow each other.
        source: What has them, for the message.
    """
    for first, second, how in _find_leaks(pictures):
        raise InputError(
            f"{source}: {first.name} ({first.side}) and {second.name} ({second.side}) {how}, so "
            "the split leaks and is not written; give both clips one place by PLACE=SOURCE, or "
            "withdraw one"
        )


def _find_leaks(pictures: Sequence[Picture]) -> Iterator[tuple[Picture, Picture, str]]:
    """Yield pairs of pictures on two sides that are one, and how; equal ones first."""
    by_digest: dict[str, Picture] = {}
    signatures = stack_signatures([picture.signature for picture in pictures])
    shown = np.atleast_1d(normalise(signatures).any(1))
    for picture in compress(pictures, shown):
        other = by_digest.setdefault(picture.digest, picture)
        if other.side != picture.side:
            yield other, picture, "are equal byte for byte"
    clips, sides = (
        np.unique([getattr(p, name) for p in pictures], return_inverse=True)[1]
        for name in ("clip", "side")
    )
    for first, second in find_copies(signatures, clips, sides, SURE_CORRELATION):
        yield pictures[first], pictures[second], "are near copies"


def check_views(views: Iterable[Mapping[str, Any]], sides: Mapping[str, str], source: Path) -> None:
    """Check the photographs of clips on two sides; InputError as :func:`check_pictures`.

    Args:
        views: Rows of spec ``views``.
        sides: {clip: side}
        source: Their file.
    """
    pictures = []
    for view in views:
        if side := sides.get(clip := view["clip"]):
            name, signature = f"frame {view['frame']} of clip {clip!r}", view["signature"]
            pictures.append(Picture(name, clip, side, view["digest"], bytes.fromhex(signature)))
    check_pictures(pictures, str(source))


def check_shards(out: Path, index: pa.Table, new: Collection[str]) -> None:
    """Check the pictures in the shards of a set before its index is written.

    The side of a picture is that of its shard's name, as other readers take it. If the check fails,
    the shards ``new`` are removed.

    Raises:
        InputError: As :func:`check_pictures`.
        OSError: If a shard cannot be read.
    """
    try:
        check_pictures(list(_pictures(out, index)), str(out))
    except InputError:
        for shard in new:
            with suppress(OSError):
                (out / shard).unlink()
        raise


def _pictures(out: Path, index: pa.Table) -> Iterator[Picture]:
    """Read the pictures of a set, those of a clip one after the other."""
    columns = ["clip", "sample", "shard", "offset", "bytes"]
    for row in index.select(columns).sort_by("clip").to_pylist():
        with (out / row["shard"]).open("rb") as shard:
            shard.seek(row["offset"])
            members = unpack(shard.read(row["bytes"]))
        for name, data in members.items():
            if name.endswith(IMAGES):
                grey = signature(glance(data)[0], SIGNATURE_SIDE).astype(np.uint8)
                side, digest = row["shard"].partition("-")[0], hashlib.sha256(data).hexdigest()
                yield Picture(f"{row['sample']}.{name}", row["clip"], side, digest, grey.tobytes())
