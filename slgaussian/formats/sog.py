"""The compressed ``.sog`` of PlayCanvas, version 2: planes of bytes as lossless WebP, in a ZIP.

Format (https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog): pixel i of
every plane belongs to Gaussian i. Means are 16-bit fixed-point numbers of ``sign(x) ln(1 + |x|)``,
rotations the three smaller components in 8 bits each, opacities 8 bits; logarithms of scales, and
harmonics, are indices into codebooks of 256 numbers, the higher harmonics by a palette of up to
65536 entries. ``meta.json`` has the codebooks and names of planes.

The axes are those of a ``.ply``: programs that write the format keep them, and viewers turn both.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.formats.spz import drop_largest
from slgaussian.formats.writable import check_writable
from slgaussian.gaussians import Gaussians
from slgaussian.io import write_file

MIN_LOG = -30.0  # written for the logarithm of smaller scales
PALETTE_COLUMNS = 64  # palette entries in a row of their plane
DENSITY_BINS = 256  # of the histogram by which a codebook is chosen


def save_sog(gaussians: Gaussians, path: str | Path, labels: np.ndarray | None = None) -> None:
    """Write Gaussians atomically as ``.sog``, which has no place for ``labels``.

    They keep their order; that of pixels compresses better than one along a curve through space.

    Raises:
        InputError: If there are no Gaussians, a number is NaN, infinite or out of range, the
            harmonics are above degree 3, the scene is too large for 16-bit means, or the file
            cannot be written.
    """
    check_writable(gaussians, "a .sog", least=1)
    arrays = gaussians.to_arrays()
    means = arrays["means"].astype(np.float64)
    logs = np.sign(means) * np.log1p(np.abs(means))
    low, high = logs.min(0), logs.max(0)
    step = (high - low) / 65535
    errors = (step * (1 + np.abs(means))).max(1) / arrays["scales"].max(1).clip(1e-30)
    if np.median(errors) > 1:
        raise InputError(
            f"gaussians means: found {np.abs(means).max():.3g} scene units from the origin, where "
            f"half of the Gaussians are smaller than {np.median(arrays['scales'].max(1)):.2g} and "
            "the 16-bit steps of a .sog larger; write a .ply, or remove those far away"
        )
    fixed, sh = np.rint((logs - low) / np.where(step > 0, step, 1)).astype(int), arrays["sh"]
    with np.errstate(divide="ignore"):  # log of a scale of 0, which is clipped
        sizes, size_book = quantise(np.log(arrays["scales"]).clip(MIN_LOG))
    colours, colour_book = quantise(sh[:, 0])
    opacities = np.rint(arrays["opacities"][:, None] * 255)
    largest, smaller = drop_largest(arrays["quats"])
    smaller = np.rint((smaller * np.sqrt(0.5) + 0.5) * 255)
    planes = {
        "means_l": fixed & 255,
        "means_u": fixed >> 8,
        "quats": np.concatenate([smaller, 252 + largest[:, None]], 1),
        "scales": sizes,
        "sh0": np.concatenate([colours, opacities], 1),
    }
    meta = {
        "version": 2,
        "asset": {"generator": "SLGaussian", "origin": gaussians.origin.tolist()},
        "count": len(gaussians),
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": size_book, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colour_book, "files": ["sh0.webp"]},
    }
    files = {f"{name}.webp": _encode_plane(plane) for name, plane in planes.items()}
    if terms := sh.shape[1] - 1:
        entries, palette = build_palette(sh[:, 1:].reshape(-1, 3 * terms))
        codes, book = quantise(palette)
        rows = -(-len(palette) // PALETTE_COLUMNS)
        texels = np.zeros((rows * PALETTE_COLUMNS * terms, 3))
        texels[: codes.size // 3] = codes.reshape(-1, 3)
        names = ["shN_centroids.webp", "shN_labels.webp"]
        files[names[0]] = _encode_plane(texels, PALETTE_COLUMNS * terms)
        files[names[1]] = _encode_plane(np.stack([entries & 255, entries >> 8, 0 * entries], 1))
        bands = math.isqrt(terms)
        meta["shN"] = {"count": len(palette), "bands": bands, "codebook": book, "files": names}
    files["meta.json"] = json.dumps(meta).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data)  # of 1980: the same bytes every day
    write_file(path, buffer.getbuffer())


def quantise(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Choose 256 numbers for values [...]; return the index of the nearest, uint8, and the numbers.

    Where values have the density p, the numbers have one in proportion to the cube root of p, which
    makes the mean squared error least (P. F. Panter, W. Dite, "Quantization distortion in
    pulse-count modulation", 1951).
    """
    counts, edges = np.histogram(values, DENSITY_BINS)
    total = np.concatenate([[0], np.cumsum(np.cbrt(counts))])
    book = np.interp((np.arange(256) + 0.5) / 256 * total[-1], total, edges).astype(np.float32)
    index = np.searchsorted((book[1:] + book[:-1]) / 2, values.ravel())
    return index.astype(np.uint8).reshape(values.shape), book.tolist()


def build_palette(rows: np.ndarray, bits: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Replace rows float32 [N, D] by the means of at most ``2 ** bits`` groups of similar ones.

    All rows are halved, ``bits`` times, at the median of the dimension in which each group varies
    most.

    Returns:
        entries: int64 [N]. Group of each row.
        palette: float32 [P, D]. Their means; the rows themselves where they are few enough.
    """
    n = len(rows)
    if n <= 2**bits:
        return np.arange(n), rows
    order = np.arange(n)
    for halvings in range(bits + 1):
        starts = np.arange(2**halvings) * n // 2**halvings
        sizes = np.diff(starts, append=n)
        groups = np.repeat(np.arange(len(starts)), sizes)
        grouped = rows[order]
        means = np.add.reduceat(grouped, starts, 0, np.float64) / sizes[:, None]
        squares = np.add.reduceat(grouped**2, starts, 0, np.float64) / sizes[:, None]
        widest = (squares - means**2).argmax(1)
        if halvings < bits:
            order = order[np.lexsort((grouped[np.arange(n), widest[groups]], groups))]
    entries = np.empty(n, np.int64)
    entries[order] = groups
    return entries, means.astype(np.float32)


def _encode_plane(values: np.ndarray, width: int = 0) -> bytes:
    """Encode bytes [N, 3 or 4], row by row, as a lossless WebP with opaque or given alpha."""
    width = width or math.ceil(math.sqrt(len(values)) / 4) * 4
    pixels = np.zeros((-(-len(values) // width) * width, values.shape[1]), np.uint8)
    pixels[: len(values)] = values
    buffer = io.BytesIO()
    # Exact: a colour counts where its alpha, an opacity, is 0.
    Image.fromarray(pixels.reshape(-1, width, values.shape[1])).save(
        buffer, "WEBP", lossless=True, exact=True
    )
    return buffer.getvalue()
