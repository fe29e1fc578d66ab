"""Boundary strength between objects at every pixel.

The cue is the half-disc contrast of Martin, Fowlkes and Malik (PAMI 2004): a disc at the pixel is
divided along eight directions and the histograms of the halves are compared by chi-squared, on
lightness, colour and texture codes. With a depth map, jumps and creases of inverse depth are added;
inverse depth is affine over any plane, so slanted floors and walls have no response.
"""

from __future__ import annotations

import cv2
import numpy as np

from slgaussian.kernels.jit import kernel

ORIENTATIONS = 8
TEXTURE_CODES = 27
TONE_BINS = 20


def tone_codes(lab: np.ndarray) -> np.ndarray:
    """Quantise L, a and b, uint8 [H, W, 3] in 0 .. 19.

    L has bins of 5; a and b are compressed by a signed square root, for finer bins near grey, where
    most colours of indoor photographs are.
    """
    chroma = np.sign(lab[..., 1:]) * np.sqrt(np.abs(lab[..., 1:]))
    steps = np.concatenate([lab[..., :1] / 5, chroma + TONE_BINS / 2], -1)
    return np.clip(steps, 0, TONE_BINS - 1).astype(np.uint8)


def texture_codes(light: np.ndarray) -> np.ndarray:
    """Compute the texture code of every pixel of a lightness map [H, W], uint8 in 0 .. 26.

    Edge (none, or weak or strong in one of four directions) x sign of the blob response: fixed
    bins instead of learned textons, so that codes are comparable between images.
    """
    fine = cv2.GaussianBlur(light, (0, 0), 1.0)
    coarse = cv2.GaussianBlur(light, (0, 0), 2.5)
    gx = cv2.Sobel(fine, cv2.CV_32F, 1, 0, scale=1 / 8)
    gy = cv2.Sobel(fine, cv2.CV_32F, 0, 1, scale=1 / 8)
    strength = np.hypot(gx, gy)
    direction = np.floor(np.arctan2(gy, gx) / np.pi * 4 + 0.5).astype(np.int32) % 4
    level = (strength > 1.0).astype(np.int32) + (strength > 3.5)
    edge = np.where(level == 0, 0, 1 + (level - 1) * 4 + direction)
    blob = fine - coarse
    sign = (blob > -0.8).astype(np.int32) + (blob > 0.8)
    return (edge * 3 + sign).astype(np.uint8)


def boundary_map(lab: np.ndarray, depth: np.ndarray | None = None) -> np.ndarray:
    """Compute boundary strength, float32 [H, W], about 0 to 1.

    Args:
        lab: float32 [H, W, 3]. CIELAB, as :attr:`slgaussian.scene.View.lab`.
        depth: float32 [H, W] or None. Predicted z-depth in scene units, 0 where unknown.
    """
    height, width = lab.shape[:2]
    half_size = (max(width // 2, 1), max(height // 2, 1))
    small = cv2.resize(lab, half_size, interpolation=cv2.INTER_AREA)
    tones = tone_codes(small)
    texture = texture_codes(lab[..., 0])[::2, ::2][: half_size[1], : half_size[0]]
    wide = 0.3 * half_disc(tones[..., 0], TONE_BINS, 3, ordered=True)
    for channel in (1, 2):
        wide += 0.45 * half_disc(tones[..., channel], TONE_BINS, 4, ordered=True)
    wide += 0.25 * half_disc(np.ascontiguousarray(texture), TEXTURE_CODES, 6, ordered=False)
    total = 0.3 * half_disc(tone_codes(lab)[..., 0], TONE_BINS, 3, ordered=True)
    strength = np.zeros((height, width), np.float32)
    for orientation in range(ORIENTATIONS):
        fused = total[orientation] + cv2.resize(wide[orientation], (width, height))
        np.maximum(strength, cv2.GaussianBlur(fused, (0, 0), 0.8), out=strength)
    return strength if depth is None else strength + depth_boundary(depth)


def half_disc(codes: np.ndarray, bins: int, radius: int, ordered: bool) -> np.ndarray:
    """Compute the contrast of the two halves of a disc at every pixel, float32 [8, H, W], 0 to 1.

    Args:
        codes: uint8 [H, W]. Histogram bin of every pixel.
        bins, radius: Number of bins; disc radius in pixels.
        ordered: Whether neighbouring bins are similar, so that histograms are blurred before
            comparison.
    """
    padded = np.pad(codes, radius, mode="reflect")
    offsets, starts = _disc(radius, padded.shape[1])
    unit = 4 if ordered else 1  # blurred counts are whole quarters
    half = len(offsets) // 2
    share = np.arange(unit * half + 1, dtype=np.float32) / np.float32(unit) / np.float32(half)
    p, q = share[:, None], share
    with np.errstate(invalid="ignore"):
        terms = (p - q) * (p - q) / (p + q)
    terms[0, 0] = 0
    return _half_disc(padded, bins, radius, ordered, offsets, starts, terms.ravel(), len(share))


def _disc(radius: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels of a disc without its centre, as offsets in a flat image, by sector.

    The 16 sectors have equal angles; sector s is ``offsets[starts[s] : starts[s + 1]]`` and has as
    many pixels as the opposite one.
    """
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    inside = (dx * dx + dy * dy <= radius * radius + 1) & ((dx != 0) | (dy != 0))
    dy, dx = dy[inside], dx[inside]
    turn = (np.arctan2(dy, dx) / (2 * np.pi) + 1 + 1e-9) % 1
    sector = (turn * 2 * ORIENTATIONS).astype(np.int64)
    order = np.argsort(sector, kind="stable")
    starts = np.searchsorted(sector[order], np.arange(2 * ORIENTATIONS + 1))
    return (dy * width + dx)[order], starts


def depth_boundary(depth: np.ndarray) -> np.ndarray:
    """Compute the strength of depth jumps and creases, float32 [H, W] in 0 to 0.5; 0 if unknown.

    The second difference of inverse depth over 3 pixels to each side, relative to inverse depth:
    zero on planes, about 0.5 at a jump where depth doubles. It is limited to half the strength of a
    full image boundary because predicted depth has false jumps in uniform areas.
    """
    positive = depth > 0
    inverse = np.where(positive, 1 / np.where(positive, depth, 1), 0).astype(np.float32)
    strength = np.zeros_like(inverse)
    reach = 3
    for axis in (0, 1):
        if inverse.shape[axis] <= 2 * reach:
            continue
        before, center, after = (
            np.moveaxis(inverse, axis, 0)[part]
            for part in (np.s_[: -2 * reach], np.s_[reach:-reach], np.s_[2 * reach :])
        )
        valid = (before > 0) & (center > 0) & (after > 0)
        bend = np.abs(before + after - 2 * center) / np.maximum(center, 1e-12)
        inner = np.moveaxis(strength, axis, 0)[reach:-reach]
        np.maximum(inner, np.where(valid, bend, 0), out=inner)
    return np.clip(cv2.GaussianBlur(strength, (0, 0), 1.0), 0, 0.5)


@kernel
def _half_disc(codes, bins, radius, ordered, offsets, starts, terms, side):
    """Compute the contrast from ``codes`` padded by ``radius`` pixels.

    An element of ``counts`` is ``side`` times the number of pixels of a bin in the first half plus
    the number in the second, an index into ``terms``, the table of contributions to chi-squared.
    Only bins between the lowest and highest of the disc are visited; a disc of one bin is skipped.
    """
    # Chi-squared of the histograms p, q of the halves: 1/2 sum (p - q)^2 / (p + q) (Martin et al.
    # 2004). Counts are small integers, so that each term is looked up in ``terms``, and both
    # counts of a bin are one number: a pixel that changes sides adds or takes ``side - 1``.
    flat, width = codes.ravel(), codes.shape[1]
    H, W = codes.shape[0] - 2 * radius, width - 2 * radius
    out = np.zeros((ORIENTATIONS, H, W), np.float32)
    size = len(offsets)
    counts = np.zeros(bins + 3, np.int32)  # of bin b at b + 1
    disc = np.empty(size, np.uintp)  # unsigned: no index is taken for one from the end
    unit, side = np.uintp(1), np.int32(side)
    for y in range(H):
        for x in range(W):
            low, high = np.uintp(bins), np.uintp(0)
            middle = (y + radius) * width + x + radius
            for k in range(size):
                place = np.uintp(flat[np.uintp(middle + offsets[k])]) + unit
                low, high, disc[k] = min(low, place), max(high, place), place
            if low == high:
                continue
            counts[max(np.int64(low) - 2, 0) : high + np.uintp(3)] = 0
            for k in range(size // 2):
                counts[disc[k]] += side
            for k in range(size // 2, size):
                counts[disc[k]] += np.int32(1)
            for o in range(ORIENTATIONS):
                chi = np.float32(0)
                if ordered:
                    # Blurred by (1, 2, 1) / 4 over neighbouring bins, the last one repeated beyond
                    # the end, which both halves of a count undergo at once.
                    counts[0], counts[bins + 1] = counts[1], counts[bins]
                    for b in range(max(low - unit, unit), min(high + unit, np.uintp(bins)) + unit):
                        blurred = counts[b - unit] + 2 * counts[b] + counts[b + unit]
                        chi += terms[np.uintp(blurred)]
                else:
                    for b in range(low, high + unit):
                        chi += terms[np.uintp(counts[b])]
                out[o, y, x] = np.float32(0.5) * chi
                # Turn the diameter by one sector: one sector changes sides, its opposite returns.
                for k in range(starts[o], starts[o + 1]):
                    counts[disc[k]] -= side - np.int32(1)
                for k in range(starts[o + ORIENTATIONS], starts[o + ORIENTATIONS + 1]):
                    counts[disc[k]] += side - np.int32(1)
    return out
