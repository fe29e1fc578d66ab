"""Round trips of compact formats, within their precision."""

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from slgaussian.errors import InputError
from slgaussian.formats.axes import turn_axes
from slgaussian.formats.ply import load_ply
from slgaussian.formats.sog import build_palette, quantise, save_sog
from slgaussian.formats.splats import WRITERS, save_gaussians
from slgaussian.formats.spz import load_spz, pack_quats, save_spz, unpack_quats
from slgaussian.gaussians import Gaussians, rotation_matrices
from slgaussian.rasterize.harmonics import compute_colours
from slgaussian.scene import Camera


def make_gaussians(n: int = 500, degree: int = 0, seed: int = 0, spread: float = 1.0) -> Gaussians:
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.15, (n, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.5, (n, 3))
    return Gaussians.from_arrays(
        {
            "means": (rng.normal(0, spread, (n, 3)) + (0, 0, 4 * spread)).astype(np.float32),
            "scales": (spread * np.exp(rng.uniform(-4, -2, (n, 3)))).astype(np.float32),
            "quats": rng.normal(size=(n, 4)).astype(np.float32),
            "opacities": rng.uniform(0.1, 1, n).astype(np.float32),
            "sh": sh.astype(np.float32),
            "source": np.arange(n, dtype=np.int32),
        }
    )


def angles(a: torch.Tensor, b: torch.Tensor) -> np.ndarray:
    """Degrees between rotations of quaternions wxyz."""
    R, Q = rotation_matrices(a.double()), rotation_matrices(b.double())
    trace = (R * Q).sum((-2, -1)).clamp(-1, 3)
    return np.degrees(np.arccos(((trace - 1) / 2).numpy()))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1, width=32)] * 4), min_size=1, max_size=20))
def test_pack_quats_keeps_rotations_within_a_third_of_a_degree(rows):
    quats = np.array(rows, np.float32)
    quats[np.linalg.norm(quats, axis=1) < 1e-3] = (0, 0, 0, 1)
    restored = unpack_quats(pack_quats(quats).astype("<u4")[:, None].view(np.uint8))
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    cosine = np.abs((unit.astype(np.float64) * restored).sum(1)).clip(0, 1)
    assert np.degrees(2 * np.arccos(cosine)).max() < 0.28
    np.testing.assert_allclose(np.linalg.norm(restored, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_round_trip_stays_within_its_precision(tmp_path, degree):
    gaussians = make_gaussians(degree=degree)
    save_spz(gaussians, tmp_path / "a.spz")
    restored = load_spz(tmp_path / "a.spz")[0]
    assert (gaussians.means - restored.means).abs().max() < 2e-6 * gaussians.means.abs().max()
    assert (gaussians.scales / restored.scales).log().abs().max() < 0.501 / 16
    assert (gaussians.opacities - restored.opacities).abs().max() <= 0.501 / 255
    assert (gaussians.sh[:, 0] - restored.sh[:, 0]).abs().max() <= 0.501 / 255 / 0.15
    if degree:
        assert (gaussians.sh[:, 1:4] - restored.sh[:, 1:4]).abs().max() <= 5 / 128
        assert (gaussians.sh[:, 1:] - restored.sh[:, 1:]).abs().max() <= 9 / 128
    assert angles(gaussians.quats, restored.quats).max() < 0.28


def test_spz_turns_harmonics_with_the_axes(tmp_path):
    """Without the rotation, colours would be those of a mirrored direction."""
    gaussians = make_gaussians(20, degree=3, seed=3)
    save_spz(gaussians, tmp_path / "a.spz")
    restored = load_spz(tmp_path / "a.spz")[0]
    cam = Camera(np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4), 64, 48)
    assert (compute_colours(gaussians, cam) - compute_colours(restored, cam)).abs().max() < 0.35
    data = bytearray(gzip.decompress((tmp_path / "a.spz").read_bytes()))
    stored = np.frombuffer(data, np.uint8)[16 + 20 * 20 :].reshape(20, 15, 3)
    # Degree 1 holds y, z and x: the first two are turned.
    signs = np.sign(stored[:, :3].astype(int) - 128) * np.sign(gaussians.sh[:, 1:4].numpy())
    assert (signs[:, :2] <= 0).all() and (signs[:, 2] >= 0).all()


def rewrite(data: bytes, version: int, flags: int = 0, extensions: bytes = b"") -> bytes:
    """Return the content of an ``.spz`` of version 3 in another version."""
    plain = gzip.decompress(data)
    _, _, n, degree, bits, _, _ = struct.unpack_from("<IIIBBBB", plain)
    widths = [9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)]
    ends = 16 + n * np.cumsum([0, *widths])
    parts = [plain[a:b] for a, b in pairwise(ends)]
    if version < 3:
        xyzw = unpack_quats(np.frombuffer(parts[4], np.uint8).reshape(n, 4))
        signed = xyzw[:, :3] * np.where(xyzw[:, 3:] < 0, -1, 1)
        parts[4] = np.rint(signed * 127.5 + 127.5).astype(np.uint8).tobytes()
    head = struct.pack("<IIIBBB", 0x5053474E, version, n, degree, bits, flags)
    if version < 4:
        return gzip.compress(head + b"\0" + b"".join(parts) + extensions)
    parts = [part for part in parts if part]
    packed = [pa.compress(part, "zstd", asbytes=True) for part in parts]
    head += struct.pack("<BI12x", len(parts), 32 + len(extensions)) + extensions
    sizes = zip(map(len, packed), map(len, parts), strict=True)
    return head + b"".join(struct.pack("<QQ", *pair) for pair in sizes) + b"".join(packed)


ORBIT_LIMITS = struct.pack("<IIfff", 0xADBE0002, 12, -1, 1, 0)
OTHER_AXES = struct.pack("<III", 0xADBE0003, 4, 5)


@pytest.mark.parametrize(
    ("version", "degree", "extensions"),
    [
        (2, 0, b""),
        (2, 3, b""),
        (3, 1, ORBIT_LIMITS),
        (3, 3, b""),
        (4, 0, ORBIT_LIMITS),
        (4, 3, b""),
    ],
)
def test_load_spz_reads_the_numbers_that_niantics_reader_reads(
    tmp_path, version, degree, extensions
):
    """Gaussforge contains the reader of https://github.com/nianticlabs/spz."""
    gaussforge = pytest.importorskip("gaussforge", reason="needs the reader gaussforge of PyPI")
    save_spz(make_gaussians(degree=degree), tmp_path / "a.spz")
    data = (tmp_path / "a.spz").read_bytes()
    if (version, extensions) != (3, b""):
        data = rewrite(data, version, 2 if extensions else 0, extensions)
        (tmp_path / "a.spz").write_bytes(data)
    theirs = gaussforge.GaussForge().convert(data, "spz", "ply")["data"]
    (tmp_path / "a.ply").write_bytes(theirs)
    ours, extra = load_spz(tmp_path / "a.spz")
    assert extra == {} and ours.source.tolist() == list(range(500))
    expected = turn_axes(load_ply(tmp_path / "a.ply")[0])  # it keeps the axes of the file
    assert [value.dtype for _, value in ours.items()] == [v.dtype for _, v in expected.items()]
    assert torch.equal(ours.means, expected.means)
    assert torch.equal(ours.sh[:, 1:], expected.sh[:, 1:])
    # The largest component is the root of a difference, which float32 rounds near 0.
    for name, error in (("sh", 1e-6), ("opacities", 1e-6), ("scales", 1e-6), ("quats", 5e-4)):
        assert torch.allclose(getattr(ours, name), getattr(expected, name), atol=error), name


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: None, "cannot be read"),
        (lambda data: b"", "is not a whole .spz file"),
        (lambda data: b"ply\nformat ascii 1.0\n", "is not a whole .spz file"),
        (lambda data: data[: len(data) // 2], "is not a whole .spz file"),
        (lambda data: gzip.compress(gzip.decompress(data)[:-1]), "found 2215 bytes, expected 2216"),
        (lambda data: gzip.compress(gzip.decompress(data) + b"a"), "found 1 bytes too many"),
        (lambda data: rewrite(data, 4)[:-9], "is not a whole .spz file"),
        (lambda data: rewrite(data, 4)[:8] + b"\xff" * 4 + rewrite(data, 4)[12:], "expected 38654"),
        (lambda data: rewrite(data, 1), "has version 1, expected an .spz of version 2, 3 or 4"),
        (lambda data: rewrite(data, 5), "has version 5, expected"),
        (lambda data: rewrite(data, 3, flags=128), "has the flags 0x80, expected"),
        (lambda data: rewrite(data, 3, flags=1), "is marked as trained with anti-aliasing"),
        (lambda data: rewrite(data, 4, 2, OTHER_AXES), "has the extension 0xadbe0003"),
    ],
)
def test_load_spz_refuses_what_it_does_not_understand_in_one_sentence(tmp_path, change, sentence):
    path = tmp_path / "a.spz"
    save_spz(make_gaussians(50, degree=2), path)
    data = change(path.read_bytes())
    path.unlink() if data is None else path.write_bytes(data)
    with pytest.raises(InputError, match=sentence) as error:
        load_spz(path)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


FAR = {"means": np.array(8 * [[1e9, 0, 0]] + 2 * [(1, 2, 3)], np.float32)}
INVALID = [
    *((suffix, {"means": np.full((10, 3), np.nan, np.float32)}, "NaN") for suffix in WRITERS),
    *(
        (suffix, {"sh": np.zeros((10, 25, 3), np.float32)}, "found 25 coefficients a colour")
        for suffix in WRITERS
    ),
    (".spz", FAR, "found 1e[+]09 scene units from the origin"),
    (".sog", FAR, "found 1e[+]09 scene units from the origin"),
]


@pytest.mark.parametrize(("suffix", "given", "sentence"), INVALID)
def test_save_gaussians_writes_nothing_for_invalid_gaussians(tmp_path, suffix, given, sentence):
    with pytest.raises(InputError, match=sentence):
        save_gaussians(make_gaussians(10).with_arrays(**given), tmp_path / f"a{suffix}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", WRITERS)
def test_save_gaussians_writes_same_bytes_or_nothing(tmp_path, suffix):
    gaussians = make_gaussians(20, degree=2)
    with pytest.raises(InputError, match="cannot be written"):
        save_gaussians(gaussians, tmp_path / "nowhere" / f"a{suffix}")
    for name in "ab":
        save_gaussians(gaussians, tmp_path / f"{name}{suffix}", np.arange(20))
    if suffix != ".rrd":  # Rerun's encoder numbers chunks by the time
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    if suffix in (".sog", ".glb"):
        with pytest.raises(InputError, match="found none"):
            save_gaussians(make_gaussians(0), tmp_path / f"c{suffix}")
    assert len(list(tmp_path.iterdir())) == 2


def test_sog_keeps_the_colour_of_transparent_gaussians(tmp_path):
    gaussians = make_gaussians(30)
    gaussians.opacities[:] = 0
    save_sog(gaussians, tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        pixels = np.array(Image.open(io.BytesIO(archive.read("sh0.webp"))))
        book = np.array(json.loads(archive.read("meta.json"))["sh0"]["codebook"])
    stored = book[pixels.reshape(-1, 4)[:30, :3]]
    assert np.abs(stored - gaussians.sh[:, 0].numpy()).max() < 0.02


def test_quantise_chooses_the_nearest_of_good_numbers():
    values = np.random.default_rng(0).laplace(size=(2000, 3))
    index, book = quantise(values)
    steps = np.abs(values[..., None] - np.array(book))
    np.testing.assert_allclose(
        np.take_along_axis(steps, index[..., None], -1)[..., 0], steps.min(-1)
    )
    even = np.linspace(values.min(), values.max(), 256)
    error = np.abs(values[..., None] - even).min(-1)
    assert (steps.min(-1) ** 2).mean() < 0.5 * (error**2).mean()


def test_build_palette_halves_groups_as_the_recursive_reference():
    rows = np.random.default_rng(0).normal(size=(1003, 9)).astype(np.float32) * np.arange(1, 10)
    rows = rows.astype(np.float32)

    def halve(members: np.ndarray, number: int, level: int) -> Iterator[np.ndarray]:
        if level == 5:
            yield members
            return
        values = rows[members].astype(np.float64)
        members = members[np.argsort(values[:, values.var(0).argmax()], kind="stable")]
        starts = np.arange(2 ** (level + 1) + 1) * len(rows) // 2 ** (level + 1)
        cut = starts[2 * number + 1] - starts[2 * number]
        yield from halve(members[:cut], 2 * number, level + 1)
        yield from halve(members[cut:], 2 * number + 1, level + 1)

    entries, palette = build_palette(rows, 5)
    for number, members in enumerate(halve(np.arange(1003), 0, 0)):
        np.testing.assert_array_equal(np.flatnonzero(entries == number), np.sort(members))
        np.testing.assert_allclose(palette[number], rows[members].mean(0), atol=1e-5)
    entries, palette = build_palette(rows[:32], 5)
    np.testing.assert_array_equal(palette[entries], rows[:32])
