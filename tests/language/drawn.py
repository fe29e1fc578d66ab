"""Drawn pictures with masks of all objects, other than those used to tune the vocabulary."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from slgaussian.labels import LabelMaps
from slgaussian.language import answer
from slgaussian.language.answer import QueryResult
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.codes import grid_codes
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader, Scorer, sigmoid
from slgaussian.scene import Camera, View

RED, GREEN, BLUE = (200, 30, 35), (40, 140, 60), (35, 75, 190)
WHITE, GREY = (238, 238, 235), (125, 125, 127)
HEIGHT, WIDTH = 240, 320


def ball(x: int, y: int, radius: int) -> np.ndarray:
    """Mask of a disc."""
    return cv2.circle(np.zeros((HEIGHT, WIDTH), np.uint8), (x, y), radius, 1, -1).view(bool)


def box(x: int, y: int, half: int) -> np.ndarray:
    """Mask of an upright box seen at a corner from slightly above."""
    up, side = int(half * 0.35), int(half * 0.9)
    top = [(-side, -half), (0, -half - up), (side, -half)]
    points = np.array([*top, (side, half), (0, half + up), (-side, half)]) + (x, y)
    return cv2.fillConvexPoly(np.zeros((HEIGHT, WIDTH), np.uint8), points, 1).view(bool)


def cone(x: int, y: int, half: int) -> np.ndarray:
    """Mask of a cone on its base."""
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    points = np.array([(x, y - half), (x + half, y + half), (x - half, y + half)])
    cv2.fillConvexPoly(canvas, points, 1)
    return cv2.ellipse(canvas, (x, y + half), (half, half // 4), 0, 0, 360, 1, -1).view(bool)


def paint(
    image: np.ndarray,
    mask: np.ndarray,
    colour: tuple[int, int, int],
    pattern: str = "plain",
    second: tuple[int, int, int] = WHITE,
) -> None:
    """Colour a mask in place with a pattern in two colours."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    regions = {
        "plain": np.zeros((HEIGHT, WIDTH), bool),
        "striped": (y // 7) % 2 == 1,
        "checked": (y // 9 + x // 9) % 2 == 1,
        "dotted": (y % 14 - 7) ** 2 + (x % 14 - 7) ** 2 < 16,
    }[pattern]
    image[mask] = colour
    image[mask & regions] = second


def photograph(objects: list[tuple], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """An image uint8 and ids int32 of ``(mask, colour, pattern)`` objects on a grey background.

    Ids are 1, 2 ... in order; the image is blurred by half a pixel and has sensor noise.
    """
    image = np.full((HEIGHT, WIDTH, 3), (150, 148, 145), np.uint8)
    ids = np.zeros((HEIGHT, WIDTH), np.int32)
    for i, (mask, colour, *pattern) in enumerate(objects, 1):
        paint(image, mask, colour, *pattern)
        ids[mask] = i
    noise = np.random.default_rng(seed).normal(0, 2, image.shape)
    soft = cv2.GaussianBlur(image, (0, 0), 0.5) + noise
    return np.clip(np.round(soft), 0, 255).astype(np.uint8), ids


def make_view(image: np.ndarray, name: str = "view") -> View:
    """Return a view with an image and an irrelevant camera."""
    h, w = image.shape[:2]
    K = np.array([[300.0, 0, w / 2], [0, 300, h / 2], [0, 0, 1]])
    return View(name, Camera(K, np.eye(4), w, h), image)


def make_bank(images: list[np.ndarray], ids: list[np.ndarray], encoder: Lexicon) -> MemoryBank:
    """The memory bank of some photographs and their id maps."""
    maps = LabelMaps(np.stack(ids), np.ones((len(ids), *ids[0].shape), np.float32))
    views = [make_view(image, f"view {i}") for i, image in enumerate(images)]
    return build_bank(views, maps, encoder, grid_codes(len(maps.ids), np.random.default_rng(0)))


def find(
    text: str, ids: np.ndarray, bank: MemoryBank, encoder: Lexicon, **rules: Any
) -> QueryResult:
    """Query one text in an id map."""
    object_map = ObjectMap(ids, bank.ids)
    return answer.ask([text], object_map, BankReader(bank, encoder), Rules(**rules))[0]


def segment(texts: list[str], ids: np.ndarray, bank: MemoryBank, encoder: Lexicon) -> np.ndarray:
    """Return the best of several texts for each object of an id map."""
    return answer.segment(texts, ObjectMap(ids, bank.ids), BankReader(bank, encoder), Rules())


def relevancy(features, present, queries, canonical, temperature=10.0, absent="skip") -> np.ndarray:
    """Relevancy of every object to every query, float64 [Q, N]."""
    return sigmoid(temperature * Scorer(features, present, canonical, absent).gaps(queries))
