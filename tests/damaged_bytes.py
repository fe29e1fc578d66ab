"""Damage to the bytes of files, suited to their format."""

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


def damage(data: bytes, name: str, rng: random.Random) -> bytes:
    """Damage one to three places of a file, in ways that suit its format, or at random."""
    ways = WAYS.get(Path(name).suffix.lower(), [])
    original, left = data, rng.choice([1, 1, 1, 2, 3])
    while left > 0 or data == original:
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
    line, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    way = rng.choice(["number", "number", "number", "word", "swap", "lose", "repeat", "odd"])
    if way in ("number", "word", "odd"):
        pattern = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?" if way == "number" else r"\S+"
        places = list(re.finditer(pattern, text))
        words = [place[0] for place in places]
        odd = [t for t in TEXTS if t.isascii()]
        start, end = rng.choice(places).span()
        new = rng.choice({"number": NUMBERS, "word": words, "odd": odd}[way])
        return (text[:start] + new + text[end:]).encode("latin-1")
    if way == "swap":
        lines[line], lines[second] = lines[second], lines[line]
    else:
        lines[line] *= 0 if way == "lose" else 2
    return "".join(lines).encode("latin-1")


def any_json(data: bytes, rng: random.Random) -> bytes:
    content = json.loads(data)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(content)
    node, key = rng.choice(places)
    left, right = rng.choice([("[", "]"), ('{"a":', "}")])
    depth = rng.choice([20, 70, DEEP])
    marked = {
        "number": rng.choice(NUMBERS),
        "deep": left * depth + "1" + right * depth,
        "twice": f'"a": 1, {json.dumps(key)}: {json.dumps(rng.choice(VALUES))}',
    }
    way = rng.choice(["value", "value", "value", "lose", "rename", "repeat", "wrap", *marked])
    if way == "lose":
        del node[key]
    elif way == "rename" and isinstance(node, dict):
        node[rng.choice(["x", *filter(None, TEXTS)])] = node.pop(key)
    elif way == "twice" and isinstance(node, dict):
        node["@MARK@"] = 0
        return json.dumps(content).replace('"@MARK@": 0', marked[way]).encode()
    elif way == "repeat" and isinstance(node, list):
        node.insert(key, node[key])
    else:
        node[key] = {"wrap": [node[key]], "value": rng.choice(VALUES)}.get(way, "@MARK@")
    return json.dumps(content).replace('"@MARK@"', marked.get(way, "1")).encode()


def any_member(data: bytes, rng: random.Random) -> bytes:
    """Damage a member of a zip archive; its checksum is updated."""
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
            "|O", "<f8", ">f4", "<i8", "|b1", "<U9", "|V9", "<c16", "<M8[s]", "<f4,(9,9)<f8", "x",
        ]  # fmt: skip
        header = re.sub(r"'descr': '[^']*'", f"'descr': '{rng.choice(types)}'", header)
    else:
        header = any_text(header.encode("latin-1"), rng).decode("latin-1")
    text = header.encode("latin-1")
    return data[:8] + struct.pack("<H", len(text)) + text + body


def any_head(data: bytes, rng: random.Random) -> bytes:
    """Damage the header of a .ply file."""
    end = data.index(b"end_header")
    return any_text(data[:end], rng) + data[end:]


def any_png(data: bytes, rng: random.Random) -> bytes:
    """Damage a chunk of a PNG; its checksum is updated."""
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
    data = data[:8]
    for kind, content in parts:
        checksum = zlib.crc32(kind + content)
        data += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)
    return data


def any_tensors(data: bytes, rng: random.Random) -> bytes:
    """Damage the header of a safetensors file; its length is updated."""
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
