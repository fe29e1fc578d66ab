"""Near copies among many photographs, told by their signatures alone.

A signature (:func:`slgaussian.copies.signature`) has 16 x 16 grey values. Copies of another
quality, size or tone have nearly the same one. That of a cropped copy is scaled and shifted, so the
likeliest pairs are laid over each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.fft import dctn

from slgaussian.copies import normalise

SIGNATURE_SIDE = 16

MIN_CORRELATION = 0.97
"""Correlation from which on two photographs show one place, after one signature, blurred, is laid
over the other. Of 286 photographs no copy of another quality, size, brightness, contrast or gamma
has less, and 1 % at most of crops by 2 to 10 % of the sides. Pairs of 66 places, 40 of them
procedural rooms, have .956 at most (26 real ones: .936); there are 40,000."""

REPEATED_CORRELATION = 0.97
"""Correlation, as they are, from which on a frame is not compared besides the one before it."""

MAX_ZOOM, MAX_SHIFT = 0.14, 1.4
"""Largest change of scale, and largest shift in cells of a signature, of a cropped copy."""

ROUNDS, MIN_ROUGH_CORRELATION = 8, 0.8
"""Rounds of fitting, and the correlation after half of them below which the rest is left out."""

WAVES, NEAREST, MIN_COARSE_CORRELATION = 6, 8, 0.35
"""Waves a side of the coarse signatures by which pairs are chosen; clips that are compared with a
photograph; and their least coarse correlation: that of crops by 10 % is .35 or more."""

BATCH, CELLS = 1024, 2**26
"""Pairs that are laid over each other at once, and pairs of which the likeliest are chosen."""


def stack_signatures(signatures: Sequence[bytes]) -> np.ndarray:
    """Stack signatures of 256 bytes each, uint8 [n, 256]."""
    return np.frombuffer(b"".join(signatures), np.uint8).reshape(-1, SIGNATURE_SIDE**2)


def find_copies(
    signatures: np.ndarray,
    clips: np.ndarray,
    groups: np.ndarray,
    least: float = MIN_CORRELATION,
) -> Iterator[tuple[int, int]]:
    """Yield pairs of signatures of different groups that agree once laid over each other.

    Every signature that is no near copy of the one before in its clip is compared with one of each
    of the :data:`NEAREST` clips of other groups.

    Args:
        signatures: uint8 [n, 256]
        clips: int [n]. Signatures of a clip follow each other.
        groups: int [n]
    """
    chosen = _distinct(normalise(signatures), clips)
    likeliest = sorted(_likeliest(signatures[chosen], clips[chosen], groups[chosen]))
    pairs = chosen[np.array(likeliest, np.int64).reshape(-1, 2)]
    values = signatures.reshape(-1, SIGNATURE_SIDE, SIGNATURE_SIDE).astype(np.float32)
    for start in range(0, len(pairs), BATCH):
        first, second = pairs[start : start + BATCH].T
        a, b = values[first], values[second]
        agreement = np.maximum(align(a, b), align(b, a))
        for k in np.flatnonzero(agreement >= least):
            yield int(first[k]), int(second[k])


def _distinct(normal: np.ndarray, clips: np.ndarray) -> np.ndarray:
    """Return the signatures that are no near copy of the one before in their clip, int [m]."""
    chosen: list[int] = []
    for index in range(len(clips)):
        is_first = not chosen or clips[chosen[-1]] != clips[index]
        if is_first or normal[index] @ normal[chosen[-1]] < REPEATED_CORRELATION:
            chosen.append(index)
    return np.array(chosen, np.int64)


def _likeliest(
    signatures: np.ndarray, clips: np.ndarray, groups: np.ndarray
) -> set[tuple[int, int]]:
    """Choose the pairs to be laid over each other, by coarse signatures."""
    coarse = _coarse(signatures)
    order = np.argsort(clips, kind="stable")
    order = order[coarse[order].any(1)]
    coarse, clips, groups = coarse[order], clips[order], groups[order]
    starts = np.flatnonzero(np.r_[True, clips[1:] != clips[:-1]]) if len(order) else order
    ends = np.r_[starts[1:], len(order)]
    pairs = set()
    rows = max(1, CELLS // max(1, len(order)))
    for begin in range(0, len(order), rows):
        likeness = coarse[begin : begin + rows] @ coarse.T
        likeness[groups[begin : begin + rows, None] == groups] = -1
        best = np.maximum.reduceat(likeness, starts, axis=1)
        nearest = np.argsort(-best, axis=1)[:, :NEAREST]
        for row, column in zip(*np.nonzero(nearest >= 0), strict=True):
            clip = nearest[row, column]
            if best[row, clip] >= MIN_COARSE_CORRELATION:
                frame = starts[clip] + likeness[row, starts[clip] : ends[clip]].argmax()
                one, other = sorted((order[begin + row], order[frame]))
                pairs.add((int(one), int(other)))
    return pairs


def _coarse(signatures: np.ndarray) -> np.ndarray:
    """Compute the longest waves of signatures, float32 [n, 36] of norm 1; 0 if blank."""
    squares = normalise(signatures).reshape(-1, SIGNATURE_SIDE, SIGNATURE_SIDE)
    waves = dctn(_blur(squares), axes=(1, 2), norm="ortho")[:, :WAVES, :WAVES]
    waves = waves.reshape(len(squares), -1)
    return waves / np.maximum(np.linalg.norm(waves, axis=1, keepdims=True), 1e-6)


def align(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Lay signatures over others by scale and shift, and return the best correlation, float [n].

    Scale and shift are fitted by least squares (Lucas and Kanade 1981), with a factor and an offset
    of the grey values. The correlation is that of the cells which both show.

    Args:
        first, second: float32 [n, 16, 16]
    """
    n = len(first)
    result = np.full(n, -1.0)
    left = np.arange(n)
    layout = np.zeros((n, 4), np.float32)  # scale - 1 of x and y, then shift in cells
    first, second = _blur(first), _blur(second)
    at = np.arange(SIGNATURE_SIDE, dtype=np.float32) - (SIGNATURE_SIDE - 1) / 2
    for remaining in range(ROUNDS, -1, -1):
        moved, mask = _warp(first[left], layout[left])
        moved, wanted = _normal_inside(moved, mask), _normal_inside(second[left], mask)
        agreement = (moved * wanted).sum((1, 2))
        result[left] = np.maximum(result[left], agreement)
        if remaining == ROUNDS // 2:
            likely = agreement >= MIN_ROUGH_CORRELATION
            left, moved, mask = left[likely], moved[likely], mask[likely]
            wanted = wanted[likely]
        if not remaining or not len(left):
            break
        slopes_y, slopes_x = (slope * mask for slope in np.gradient(moved, axis=(1, 2)))
        terms = slopes_x * at, slopes_y * at[:, None], slopes_x, slopes_y, moved, mask
        design = np.stack(terms, -1).reshape(-1, SIGNATURE_SIDE**2, len(terms))
        rest = (wanted - moved).reshape(-1, SIGNATURE_SIDE**2, 1)
        normal = design.transpose(0, 2, 1) @ design
        damping = 1e-3 * np.trace(normal, axis1=1, axis2=2) / len(terms) + 1e-9
        normal += np.eye(len(terms)) * damping[:, None, None]
        layout[left] += np.linalg.solve(normal, design.transpose(0, 2, 1) @ rest)[:, :4, 0]
        np.clip(layout[:, :2], -MAX_ZOOM, MAX_ZOOM, out=layout[:, :2])
        np.clip(layout[:, 2:], -MAX_SHIFT, MAX_SHIFT, out=layout[:, 2:])
    return result


def _blur(squares: np.ndarray) -> np.ndarray:
    wide = np.pad(squares, ((0, 0), (1, 1), (1, 1)), mode="edge")
    wide = (wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]) / 4
    return (wide[:, :, :-2] + 2 * wide[:, :, 1:-1] + wide[:, :, 2:]) / 4


def _warp(squares: np.ndarray, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale and shift squares [n, 16, 16]; return them, and a mask of cells that they show."""
    side = squares.shape[1]
    at = np.arange(side, dtype=np.float32) - (side - 1) / 2
    weights, inside = [], []
    for axis in (0, 1):
        place = at * (1 + layout[:, axis, None]) + layout[:, 2 + axis, None] + (side - 1) / 2
        inside.append((place > -0.5) & (place < side - 0.5))
        place = np.clip(place, 0, side - 1)
        distance = np.abs(place[:, :, None] - np.arange(side, dtype=np.float32))
        weights.append(np.maximum(1 - distance, 0))
    moved = weights[1] @ squares @ weights[0].transpose(0, 2, 1)
    return moved, (inside[1][:, :, None] & inside[0][:, None, :]).astype(np.float32)


def _normal_inside(squares: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Bring squares to mean 0 and norm 1 inside a mask, and to 0 outside."""
    mean = (squares * mask).sum((1, 2), keepdims=True) / mask.sum((1, 2), keepdims=True)
    centred = (squares - mean) * mask
    norm = np.linalg.norm(centred, axis=(1, 2), keepdims=True)
    return centred / np.maximum(norm, 1e-3)
