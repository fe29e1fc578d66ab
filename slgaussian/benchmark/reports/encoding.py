"""Pictures as part of a page."""

from __future__ import annotations

import base64
import io

import cv2
import numpy as np
from PIL import Image

from slgaussian.benchmark.reports.model import Picture

QUALITY = 75
"""Of WebP: a third of the bytes of a JPEG in which thin outlines are as clear."""


def picture(image: np.ndarray, width: int, caption: str, alt: str = "") -> Picture:
    """Return an image uint8 [H, W, 3] as a picture at most ``width`` pixels wide."""
    if image.shape[1] > width:
        height = round(image.shape[0] * width / image.shape[1])
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    out = io.BytesIO()
    Image.fromarray(image).save(out, "WEBP", quality=QUALITY)
    return Picture(data_uri(out.getvalue(), "webp"), caption, alt or caption)


def data_uri(data: bytes, kind: str) -> str:
    """Return the bytes of a file of ``image/<kind>`` as an address that is itself."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
