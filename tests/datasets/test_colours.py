"""Colours of photographs whose files state another space than sRGB, at every entry."""

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from slgaussian.datasets.photographs import open_photograph, rgb
from slgaussian.datasets.sharpness import glance, small
from slgaussian.datasets.unposed import photograph

COLORANTS = {
    "srgb": ([0.43607, 0.22249, 0.01392], [0.38515, 0.71687, 0.09708], [0.14307, 0.06061, 0.7141]),
    "p3": ([0.51512, 0.2412, -0.00105], [0.29198, 0.69225, 0.04189], [0.1571, 0.06657, 0.78407]),
    "adobe": (
        [0.60974, 0.31111, 0.01947],
        [0.20528, 0.62567, 0.06087],
        [0.14919, 0.06322, 0.74457],
    ),
    "prophoto": ([0.79767, 0.28804, 0], [0.13519, 0.71188, 0], [0.03134, 0.00009, 0.82491]),
}
"""XYZ of red, green and blue at D50, as published in the profiles of these names."""

GAMMAS = {"srgb": None, "p3": None, "adobe": 563 / 256, "prophoto": 1.8}
LEVEL = np.arange(256) / 255
SRGB_LIGHT = np.where(LEVEL <= 0.04045, LEVEL / 12.92, ((LEVEL + 0.055) / 1.055) ** 2.4)
COLOURS = np.random.default_rng(0).integers(40, 216, (24, 36, 3)).astype(np.uint8)


def decode_levels(gamma: float | None) -> np.ndarray:
    return SRGB_LIGHT if gamma is None else LEVEL**gamma


def curve(gamma: float | None) -> bytes:
    if gamma is not None:
        return b"curv\0\0\0\0" + struct.pack(">IH2x", 1, round(gamma * 256))
    table = np.interp(np.linspace(0, 1, 4096), LEVEL, SRGB_LIGHT)
    return (
        b"curv\0\0\0\0" + struct.pack(">I", 4096) + np.round(table * 65535).astype(">u2").tobytes()
    )


def profile(space: bytes, tags: dict[bytes, bytes]) -> bytes:
    """Write an ICC profile of version 2 (ICC.1:2001-04, section 6)."""
    tags = {b"desc": b"desc\0\0\0\0\0\0\0\2x\0" + bytes(78), b"cprt": b"text\0\0\0\0x\0\0\0"} | tags
    table, content, start = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for name, value in tags.items():
        table += name + struct.pack(">2I", start + len(content), len(value))
        content += value + bytes(-len(value) % 4)
    size, version = start + len(content), 0x02400000
    head = struct.pack(">I4xI4s4s4s12x4s28x", size, version, b"mntr", space, b"XYZ ", b"acsp")
    head += struct.pack(">3i", 63190, 65536, 54061) + bytes(48)  # D50
    return head + table + content


def rgb_profile(name: str) -> bytes:
    xyz = [
        b"XYZ \0\0\0\0" + struct.pack(">3i", *np.round(np.multiply(c, 65536)).astype(int))
        for c in COLORANTS[name]
    ]
    curves = dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve(GAMMAS[name]))
    return profile(b"RGB ", dict(zip((b"rXYZ", b"gXYZ", b"bXYZ"), xyz, strict=True)) | curves)


def grey_profile(gamma: float) -> bytes:
    return profile(b"GRAY", {b"kTRC": curve(gamma)})


def right(name: str, gamma: float | None = None) -> np.ndarray:
    """Compute the colours in sRGB from the colorants alone, float [24, 36, 3]."""
    light = decode_levels(gamma or GAMMAS[name])[COLOURS] @ np.array(COLORANTS[name])
    return encode(light @ np.linalg.inv(COLORANTS["srgb"]))


def encode(light: np.ndarray) -> np.ndarray:
    return 255 * np.interp(light.clip(0, 1), SRGB_LIGHT, LEVEL)


def chunks(gamma: float | None = None, primaries=None, srgb: bool = False) -> PngInfo:
    info = PngInfo()
    if gamma is not None:
        info.add(b"gAMA", struct.pack(">I", round(gamma * 1e5)))
    if primaries is not None:
        info.add(b"cHRM", struct.pack(">8I", *(round(v * 1e5) for v in primaries)))
    if srgb:
        info.add(b"sRGB", b"\0")
    return info


P3_PRIMARIES = (0.3127, 0.329, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06)
GREY = np.repeat(COLOURS[..., :1], 3, axis=-1)


def save(file: Path, pixels=COLOURS, mode=None, **how) -> Path:
    Image.fromarray(pixels, mode).save(file, **how)
    return file


P3, ADOBE, PROPHOTO = map(rgb_profile, ("p3", "adobe", "prophoto"))
EXACT = {"quality": 100, "subsampling": 0}
SAVED = {
    "JPEG, P3": ("c.jpg", {"icc_profile": P3, **EXACT}, right("p3")),
    "PNG, Adobe RGB": ("c.png", {"icc_profile": ADOBE}, right("adobe")),
    "TIFF, ProPhoto": ("c.tif", {"icc_profile": PROPHOTO}, right("prophoto")),
    "WebP, P3": ("c.webp", {"icc_profile": P3, "lossless": True}, right("p3")),
    "PNG, gamma 1 of 1.8": ("c.png", {"pnginfo": chunks(1 / 1.8)}, right("srgb", 1.8)),
    "PNG, primaries": ("c.png", {"pnginfo": chunks(1 / 2.2, P3_PRIMARIES)}, right("p3")),
    "PNG, sRGB overrides": ("c.png", {"pnginfo": chunks(1, P3_PRIMARIES, srgb=True)}, COLOURS),
    "PNG, a profile first": ("c.png", {"pnginfo": chunks(1), "icc_profile": P3}, right("p3")),
    "PNG, usual gamma": ("c.png", {"pnginfo": chunks(1 / 2.2)}, COLOURS),
    "PNG, sRGB by profile": ("c.png", {"icc_profile": rgb_profile("srgb")}, COLOURS),
}


@pytest.mark.parametrize("kind", SAVED)
def test_colours_become_srgb_at_every_entry(tmp_path, kind):
    name, how, expected = SAVED[kind]
    file = save(tmp_path / name, **how)
    pixels, _ = open_photograph(file)
    error = np.abs(pixels - expected)
    assert error.mean() < 1 and (name == "c.jpg" or error.max() <= 1)  # JPEG itself is inexact
    if expected is COLOURS:
        assert np.array_equal(pixels, COLOURS)
    assert np.array_equal(photograph(file, "c").image, pixels)
    with Image.open(io.BytesIO(file.read_bytes())) as image:
        assert np.array_equal(rgb(image, "c"), pixels)
        assert np.array_equal(
            rgb(image.transpose(Image.Transpose.ROTATE_90), "c"), np.rot90(pixels)
        )
    grey, _ = glance(file.read_bytes())
    assert np.abs(grey.astype(int) - small(pixels)).max() <= 1


def test_grey_palettes_and_transparent_colours_follow_their_profile(tmp_path):
    expected = encode(decode_levels(1.8)[GREY])
    for file in (
        save(tmp_path / "8.png", GREY[..., 0], icc_profile=grey_profile(1.8)),
        save(tmp_path / "16.png", GREY[..., 0] * np.uint16(257), icc_profile=grey_profile(1.8)),
    ):
        assert np.abs(open_photograph(file)[0] - expected).max() <= 1
    few = Image.fromarray(COLOURS // 64 * 64).quantize(64)
    few.save(tmp_path / "p.png", icc_profile=ADOBE)
    expected = decode_levels(GAMMAS["adobe"])[np.asarray(few.convert("RGB"))] @ np.array(
        COLORANTS["adobe"]
    )
    expected = encode(expected @ np.linalg.inv(COLORANTS["srgb"]))
    assert np.abs(open_photograph(tmp_path / "p.png")[0] - expected).max() <= 1
    alpha = np.full((24, 36), 255, np.uint8)
    alpha[:, :9] = 0
    file = save(tmp_path / "a.png", np.dstack([COLOURS, alpha]), icc_profile=P3)
    pixels, opaque = open_photograph(file)
    assert np.abs(pixels - right("p3"))[:, 9:].max() <= 1 and not pixels[:, :9].any()
    assert np.array_equal(opaque, alpha == 255)


@pytest.mark.parametrize(
    ("index", "space", "is_adobe"), [("R03", 65535, True), ("R98", 1, False), ("R03", 1, False)]
)
def test_exif_tells_adobe_rgb_unless_a_profile_says_otherwise(tmp_path, index, space, is_adobe):
    tags = Image.Exif()
    tags.get_ifd(0x8769).update({0xA001: space, 0xA005: {1: index}})
    how = {"exif": tags, **EXACT}
    plain = open_photograph(save(tmp_path / "plain.jpg", **EXACT))[0]
    pixels, _ = open_photograph(save(tmp_path / "a.jpg", **how))
    if is_adobe:
        assert np.abs(pixels - right("adobe")).mean() < 1 < np.abs(plain - right("adobe")).mean()
    else:
        assert np.array_equal(pixels, plain)
    pixels, _ = open_photograph(save(tmp_path / "b.jpg", icc_profile=rgb_profile("srgb"), **how))
    assert np.array_equal(pixels, plain)


@pytest.mark.parametrize("bad", [b"no profile", P3[:300], grey_profile(1.8)])
def test_unusable_profile_gives_a_warning_and_srgb(tmp_path, bad):
    file = save(tmp_path / "c.png", icc_profile=bad)
    with pytest.warns(UserWarning, match=r"c\.png: its colour profile cannot be used \(.*as sRGB"):
        assert np.array_equal(open_photograph(file)[0], COLOURS)
