"""The contact sheet of ``docs/measured/regions.md``: truth, and regions before and now."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from PIL import Image

HEIGHT = 168
WIDTH = 1560
GAP = 6
COLORS = np.random.default_rng(5).integers(40, 256, (4096, 3)).astype(np.uint8)


def outlined(image: np.ndarray, truths: Mapping[str, np.ndarray]) -> np.ndarray:
    """A photograph uint8 [H, W, 3] with the border of every true mask drawn on it."""
    shown = image.copy()
    for number, mask in enumerate(truths.values()):
        lines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(shown, lines, -1, (0, 0, 0), 4)
        cv2.drawContours(shown, lines, -1, hue(number / max(len(truths), 1)), 2)
    return shown


def hue(turn: float) -> tuple[int, int, int]:
    color = np.array([[[180 * turn, 255, 255]]]).astype(np.uint8)
    red, green, blue = cv2.cvtColor(color, cv2.COLOR_HSV2RGB)[0, 0]
    return int(red), int(green), int(blue)


def painted(labels: np.ndarray) -> np.ndarray:
    """Regions [H, W] in colours of their own, with white borders."""
    shown = COLORS[labels % len(COLORS)]
    border = np.zeros(labels.shape, bool)
    border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    border[1:] |= labels[1:] != labels[:-1]
    shown[border] = 255
    return shown


def sheet(strips: Sequence[Sequence[np.ndarray]]) -> Image.Image:
    """Pictures of one photograph side by side, and such strips in rows as wide as the sheet."""
    rows: list[list[Image.Image]] = [[]]
    for strip in strips:
        small = [Image.fromarray(part) for part in strip]
        small = [
            part.resize((round(part.width * HEIGHT / part.height), HEIGHT), Image.Resampling.BOX)
            for part in small
        ]
        joined = Image.new("RGB", (sum(part.width for part in small) + 2 * GAP, HEIGHT), "white")
        left = GAP // 2
        for part in small:
            joined.paste(part, (left, 0))
            left += part.width + GAP // 4
        if sum(part.width + GAP for part in rows[-1]) + joined.width > WIDTH:
            rows.append([])
        rows[-1].append(joined)
    out = Image.new("RGB", (WIDTH, len(rows) * (HEIGHT + GAP)), "white")
    for line, row in enumerate(rows):
        left = 0
        for strip_image in row:
            out.paste(strip_image, (left, line * (HEIGHT + GAP)))
            left += strip_image.width + GAP
    return out
