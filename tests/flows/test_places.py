"""A corpus with copies under other names: no picture stands on both sides of any split."""

import io
import os
import re
import tarfile
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from command import files_below
from PIL import Image

from slgaussian import datasets
from slgaussian.datasets import re10k

pytestmark = pytest.mark.usefixtures("server")

SMALL = ("--size", "72x96", "--set", "most=1", "--set", "replicas=1")


def clip(seed: int, name: str = "", cut: float = 0, quality: int = 95, scale: float = 1, light=1.0):
    """Return a room as a clip, cropped by a share of its sides, recompressed, resized, darkened."""
    size = {"height": 90, "width": 160}
    scene = datasets.load("procedural", seed=seed, objects=4, views=4, baseline=1.0, **size)
    original = re10k.encode_clip(scene)
    images, cameras = [], original.cameras.copy()
    for data in original.images:
        pixels = np.asarray(Image.open(io.BytesIO(data)))
        top, left = round(0.3 * cut * len(pixels)), round(0.6 * cut * pixels.shape[1])
        height, width = (round((1 - cut) * side) for side in pixels.shape[:2])
        pixels = pixels[top : top + height, left : left + width]
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        out = io.BytesIO()
        Image.fromarray((light * pixels).astype(np.uint8)).save(out, "JPEG", quality=quality)
        images.append(out.getvalue())
    shares = np.array([width / 160, height / 90])
    cameras[:, :2] /= shares
    cameras[:, 2:4] = (cameras[:, 2:4] - np.array([left / 160, top / 90])) / shares
    key = f"room{seed}{name}"
    return replace(original, key=key, images=images, cameras=cameras, url=f"https://video/{key}")


COPIES = {
    "recompressed": {"quality": 80},
    "cropped2": {"cut": 0.02, "quality": 80},
    "cropped5": {"cut": 0.05, "quality": 80},
    "cropped10": {"cut": 0.10, "quality": 80},
    "darker": {"light": 0.7},
    "larger": {"scale": 1.5},
}


def find_seed(clip: str) -> str:
    return re.match(r"room\d+", clip)[0]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    """Four chunks: rooms, copies of them under other videos, and more rooms."""
    folder = tmp_path_factory.mktemp("corpus")
    seeds = (0, 1, 2, 4, 5, 6)
    re10k.write(folder / "rooms", [clip(seed) for seed in seeds])
    copies = [
        clip(seed, name, **how) for seed, (name, how) in zip(seeds, COPIES.items(), strict=True)
    ]
    re10k.write(folder / "copies", copies)
    re10k.write(folder / "more", [clip(seed) for seed in (7, 8)])
    for file in folder.rglob("*.torch"):
        os.utime(file, (time.time() - 60,) * 2)
    return folder


def read_sides(out: Path) -> dict[str, str]:
    rows = pq.read_table(out / "places.parquet").to_pylist()
    return {row["clip"]: row["split"] for row in rows}


def read_pictures(out: Path) -> dict[str, list[np.ndarray]]:
    """Read the pictures of a set as other readers do: grey, as they are in the tar files."""
    pictures = defaultdict(list)
    for shard in out.glob("*.tar"):
        with tarfile.open(shard) as archive:
            for member in archive:
                if member.name.endswith(".jpg"):
                    image = Image.open(archive.extractfile(member)).convert("L")
                    pictures[shard.name.partition("-")[0]].append(np.asarray(image, np.float32))
    return pictures


def likeness(a: np.ndarray, b: np.ndarray) -> float:
    """Correlate the middle of a picture with all that another shows, at three scales."""
    height, width = a.shape
    middle = cv2.GaussianBlur(a, (0, 0), 1.5)[height // 8 : -height // 8, width // 8 : -width // 8]
    b = cv2.GaussianBlur(b, (0, 0), 1.5)
    shrunk = [cv2.resize(middle, None, fx=1 / z, fy=1 / z) for z in (1, 1.05, 1.11)]
    return max(cv2.matchTemplate(b, part, cv2.TM_CCOEFF_NORMED).max() for part in shrunk)


def test_no_picture_is_in_both_splits_of_a_set_that_grows(corpus, tmp_path, slg):
    out = tmp_path / "set"
    words = ("--targets", "1", "--held-out", "0.4", "--store", tmp_path / "store", *SMALL)
    before, sources = {}, []
    for added in ("rooms", "copies", "more"):
        sources.append(corpus / added)
        status, text, errors = slg("dataset", out, *sources, *words)
        assert status == 0, errors
        sides = read_sides(out)
        assert before.items() <= sides.items()
        before = sides
    assert "places: 8, held out " in text
    assert "clips: 14, new 2, alone 2, joined 12 by near copy, left out 0" in text
    rows = pq.read_table(out / "index.parquet").to_pylist()
    assert len(rows) == 14 and all(sides[row["clip"]] == row["split"] for row in rows)
    by_room = defaultdict(set)
    for row in rows:
        by_room[find_seed(row["clip"])].add((row["place"], row["split"]))
    assert all(len(places) == 1 for places in by_room.values()) and len(by_room) == 8
    pictures = read_pictures(out)
    across = [likeness(a, b) for a in pictures["train"] for b in pictures["test"]]
    assert max(across) < 0.97 and len(pictures["train"]) * len(pictures["test"]) == len(across) > 0
    same = [likeness(*pair) for pair in zip(*[iter(pictures["train"])] * 2, strict=False)]
    assert len(same) > 3


def test_a_set_that_leaks_is_refused_and_stays_as_it_was(corpus, tmp_path, slg, monkeypatch):
    out = tmp_path / "set"
    words = ("--targets", "1", "--held-out", "0.4", "--store", tmp_path / "store", *SMALL)
    assert slg("dataset", out, corpus / "rooms", *words)[0] == 0
    before = files_below(out)
    from slgaussian.datasets import scene_grouping

    # The plan is blind, the check is not.
    monkeypatch.setattr(scene_grouping, "find_copies", lambda *arguments: ())
    status, _, errors = slg("dataset", out, corpus / "rooms", corpus / "copies", *words)
    assert status == 2 and "so the split leaks and is not written; give" in errors
    assert files_below(out) == before
