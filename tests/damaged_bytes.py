"""Bytes of files damaged in ways that fit their kind."""

from __future__ import annotations

import io
import json
import random
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS = [
    "-1", "0", "1", "2", "0.5", "-0.0", "NaN", "Infinity", "-Infinity", "1e309", "1e-320", "1e12",
    "65536", "2147483647", "2147483648", "-2147483649", "4294967296", "9223372036854775807",
    "18446744073709551616", "99999999999999999999999999", "9" * 400, "9" * 5000, "1" + "0" * 308,
]  # fmt: skip
TEXTS = [
    "", " ", ".", "..", "/", "../../x", "/etc/passwd", "a\0b", "\ud800", "x" * 5000, "💥", "NUL",
]  # fmt: skip
VALUES = [
    None, True, [], {}, [[]], [1], "1", -1, 0, 3, 1e308, 10**18, 10**30, 10**400,
    float("nan"), float("inf"), [[1, 2], [3]], {"a": 1}, [None] * 17, *TEXTS,
]  # fmt: skip
DEEP = 100_000
SIZES = [0, 1, 2, 255, 20_000, 65_535, 2**31 - 1, 2**32 - 1]


def damaged(data: bytes, name: str, rng: random.Random) -> bytes:
    """The file with one to three places damaged, in ways that fit its kind, or in any."""
    ways = WAYS.get(Path(name).suffix.lower(), [])
    whole, left = data, rng.choice([1, 1, 1, 2, 3])
    while left > 0 or data == whole:
        way = rng.choice([any_bytes, *ways, *ways])
        try:
            data = way(data, rng)
        except Exception:  # a way that does not fit, or no longer
            data = any_bytes(data or b"\0", rng)
        left -= 1
    return data


def any_bytes(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    length = rng.choice([1, 2, 4, 8, 16, rng.randrange(1, 200)])
    number = rng.choice([0, 1, -1, 2**15, 2**31 - 1, -(2**31), 2**40, 2**62, -(2**63), 2**63 - 1])
    ways = {
        "flip": lambda: _put(data, at, bytes([data[at % len(data)] ^ 1 << rng.randrange(8)])),
        "noise": lambda: _put(data, at, rng.randbytes(length)),
        "fill": lambda: _put(data, at, bytes([rng.choice([0, 255, 127, 128])]) * length),
        "number": lambda: _put(data, at, struct.pack("<q", number)[: rng.choice([2, 4, 8])]),
        "float": lambda: _put(
            data, at, struct.pack("<d", rng.choice([np.nan, np.inf, -1e308, 1e-320, 0.0]))
        ),
        "cut": lambda: data[:at],
        "insert": lambda: data[:at] + rng.randbytes(length) + data[at:],
        "lose": lambda: data[:at] + data[at + length :],
        "repeat": lambda: data[: at + length] + data[at:],
        "behead": lambda: data[length:],
        "empty": lambda: rng.choice([b"", b"\0", b"<html>", data + data, b"\xff" * 50]),
    }
    weights = [8, 4, 3, 6, 3, 3, 3, 3, 3, 1, 1]
    return ways[rng.choices(list(ways), weights)[0]]()


def _put(data: bytes, at: int, what: bytes) -> bytes:
    return data[:at] + what + data[at + len(what) :]


def any_text(data: bytes, rng: random.Random) -> bytes:
    text = data.decode("latin-1")
    lines = text.splitlines(keepends=True)
    line = rng.randrange(len(lines))
    numbers = list(re.finditer(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text))
    words = list(re.finditer(r"\S+", text))
    way = rng.choice(["number", "number", "number", "word", "swap", "lose", "repeat", "odd"])
    if way == "number":
        found = rng.choice(numbers)
        text = text[: found.start()] + rng.choice(NUMBERS) + text[found.end() :]
    elif way in ("word", "odd"):
        found = rng.choice(words)
        new = (
            rng.choice([t for t in TEXTS if t.isascii()]) if way == "odd" else rng.choice(words)[0]
        )
        text = text[: found.start()] + new + text[found.end() :]
    elif way == "swap":
        other = rng.randrange(len(lines))
        lines[line], lines[other] = lines[other], lines[line]
        text = "".join(lines)
    else:
        lines[line] *= 0 if way == "lose" else 2
        text = "".join(lines)
    return text.encode("latin-1")


def any_json(data: bytes, rng: random.Random) -> bytes:
    content = json.loads(data)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(content)
    if not places:
        return data
    node, key = rng.choice(places)
    way = rng.choice(
        ["value", "value", "value", "number", "lose", "rename", "repeat", "wrap", "deep"]
    )
    deep = None
    if way == "value":
        node[key] = rng.choice(VALUES)
    elif way == "number":
        node[key] = "@NUMBER@"
        deep = ("@NUMBER@", rng.choice(NUMBERS))
    elif way == "lose":
        del node[key]
    elif way == "wrap":
        node[key] = [node[key]]
    elif way == "deep":
        node[key] = "@DEEP@"
        left, right = rng.choice([("[", "]"), ('{"a":', "}")])
        depth = rng.choice([20, 70, DEEP])
        deep = ("@DEEP@", left * depth + "1" + right * depth)
    elif isinstance(node, dict) and way == "rename":
        node[rng.choice(["x", *(t for t in TEXTS if t)])] = node.pop(key)
    elif isinstance(node, dict):
        value = node[key]
        node["@KEY@"] = rng.choice([value, *VALUES])
        deep = ('"@KEY@"', json.dumps(key))
    else:
        node.insert(key, node[key])
    text = json.dumps(content)
    if deep is not None:
        text = text.replace(json.dumps(deep[0]) if deep[0][0] == "@" else deep[0], deep[1])
    return text.encode()


def any_member(data: bytes, rng: random.Random) -> bytes:
    """A member of a zip archive damaged, its checksum right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    at = rng.randrange(len(members))
    pickles = [i for i, (name, _) in enumerate(members) if name.endswith(".pkl")]
    if pickles and rng.random() < 0.7:
        at = pickles[0]
    name, content = members[at]
    packed = zipfile.ZIP_STORED
    way = rng.choice(["content"] * 6 + ["lose", "repeat", "rename", "swap", "pack", "zeros"])
    if way == "content":
        ways = [any_bytes, any_npy, any_npy] if name.endswith(".npy") else [any_bytes]
        members[at] = (name, rng.choice(ways)(content, rng))
    elif way == "lose":
        del members[at]
    elif way == "repeat":
        members.insert(at, members[at])
    elif way == "rename":
        members[at] = (rng.choice(["../../x", "/x.npy", "x.npy", name + "x"]), content)
    elif way == "swap":
        members[at] = (name, rng.choice(members)[1])
    elif way == "zeros":
        members[at] = (name, content[: rng.choice([0, 80, 128])] + bytes(2**20))
    if way in ("pack", "zeros"):
        packed = zipfile.ZIP_DEFLATED
    out = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", packed) as archive:
        warnings.simplefilter("ignore")  # of two members with one name
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content, packed)
    return out.getvalue()


def any_npy(data: bytes, rng: random.Random) -> bytes:
    (length,) = struct.unpack("<H", data[8:10])
    header, body = data[10 : 10 + length].decode("latin-1"), data[10 + length :]
    way = rng.choice(["shape", "shape", "type", "text"])
    if way == "shape":
        sizes = ["0", "1", "3", "-1", "1000000", "3000000000", "9223372036854775807", "1.5", "'a'"]
        shape = ", ".join(rng.choice(sizes) for _ in range(rng.randrange(5)))
        header = re.sub(r"\(.*?\)", f"({shape},)" if shape else "()", header, count=1)
    elif way == "type":
        types = [
            "|O",
            "<f8",
            ">f4",
            "<i8",
            "|b1",
            "<U9",
            "|V9",
            "<c16",
            "<M8[s]",
            "<f4,(9,9)<f8",
            "x",
        ]
        header = re.sub(r"'descr': '[^']*'", f"'descr': '{rng.choice(types)}'", header)
    else:
        header = any_text(header.encode("latin-1"), rng).decode("latin-1")
    text = header.encode("latin-1")
    return data[:8] + struct.pack("<H", len(text)) + text + body


def any_head(data: bytes, rng: random.Random) -> bytes:
    """The text of a .ply's header damaged."""
    end = data.index(b"end_header")
    return any_text(data[:end], rng) + data[end:]


def any_png(data: bytes, rng: random.Random) -> bytes:
    """A part of a PNG damaged, its checksum right."""
    parts, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        parts.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    way = rng.choice(["size", "size", "kind", "pixels", "lose", "repeat", "bytes"])
    at = rng.randrange(len(parts))
    kind, content = parts[at]
    if way == "size":
        size = struct.pack(">I", rng.choice(SIZES))
        parts[0] = (b"IHDR", _put(parts[0][1], rng.choice([0, 4]), size))
    elif way == "kind":
        parts[0] = (b"IHDR", _put(parts[0][1], rng.randrange(8, 13), rng.randbytes(1)))
    elif way == "pixels":
        at = next(i for i, part in enumerate(parts) if part[0] == b"IDAT")
        parts[at] = (b"IDAT", zlib.compress(any_bytes(zlib.decompress(parts[at][1]), rng)))
    elif way == "bytes":
        parts[at] = (kind, any_bytes(content, rng))
    else:
        parts[at : at + 1] = [] if way == "lose" else [parts[at]] * 2
    return data[:8] + b"".join(
        struct.pack(">I", len(content))
        + kind
        + content
        + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in parts
    )


def any_tensors(data: bytes, rng: random.Random) -> bytes:
    """The header of a safetensors file damaged, its length right."""
    (length,) = struct.unpack("<Q", data[:8])
    header = rng.choice([any_json, any_text])(data[8 : 8 + length], rng)
    return struct.pack("<Q", len(header)) + header + data[8 + length :]


WAYS: dict[str, list[Callable[[bytes, random.Random], bytes]]] = {
    ".json": [any_json, any_json, any_text],
    ".txt": [any_text, any_text],
    ".npz": [any_member, any_member],
    ".torch": [any_member, any_member],
    ".ckpt": [any_member, any_member],
    ".npy": [any_npy],
    ".png": [any_png],
    ".ply": [any_head],
    ".safetensors": [any_tensors],
}
