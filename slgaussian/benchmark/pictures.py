"""Visualisation of labels, depth, relevancy and masks, and encoding of the images.

Every function takes and returns uint8 RGB [H, W, 3] and is deterministic.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from skimage.color import lab2rgb

PREDICTED_COLOUR = (64, 224, 255)
"""Outline of a predicted mask."""
TRUE_COLOUR = (255, 214, 10)
"""Outline of a true mask."""
POINT_COLOUR = (255, 45, 85)
"""Colour of the predicted point of a query."""
CAPTION_COLOUR = (40, 44, 52)
"""Colour of captions on white."""

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def label_colours(ids: np.ndarray) -> np.ndarray:
    """Return the colour of each object id, uint8 [..., 3], determined by the id; 0 is nearly black.

    Successive ids are a golden angle apart in CIELAB hue and alternate in lightness and chroma, so
    that successive ids, which are often neighbours in the image, differ most. The first 24 ids are
    at least 15 CIELAB units apart; 2.3 is a just noticeable difference.
    """
    ids = np.asarray(ids)
    hue = ids * _GOLDEN_ANGLE
    lightness = np.choose(ids % 3, [69.0, 81.0, 50.0])
    chroma = np.choose(ids % 2, [38.0, 64.0])
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], -1)
    rgb = np.clip(lab2rgb(lab.reshape(1, -1, 3)).reshape(lab.shape), 0, 1)
    return np.where((ids == 0)[..., None], 28, np.round(rgb * 255)).astype(np.uint8)


def paint_labels(labels: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Paint object ids int [H, W] over the grey photograph, with thin dark borders."""
    ids, index = np.unique(labels, return_inverse=True)
    flat = label_colours(ids)[index.reshape(labels.shape)].astype(np.float64)
    shade = 0.55 + 0.55 * _grey(image) / 255
    painted = np.clip(flat * shade[..., None], 0, 255)
    edges = [np.diff(labels, axis=axis, prepend=labels.take([0], axis)) for axis in (0, 1)]
    painted[(edges[0] != 0) | (edges[1] != 0)] *= 0.45
    return painted.astype(np.uint8)


def depth_range(*depths: np.ndarray) -> tuple[float, float]:
    """Return the range of depth colours (1st and 99th percentile); (1, 1) if no depth is known."""
    positive = np.concatenate([depth[depth > 0].ravel() for depth in depths])
    if not positive.size:
        return 1.0, 1.0
    near, far = np.percentile(positive.astype(np.float64), [1, 99])
    return float(near), float(far)


def paint_depth(depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """Paint z-depth [H, W] in turbo colours of inverse depth: red near, blue far, dark unknown."""
    is_known = depth > 0
    inverse = 1 / np.where(is_known, depth, far).astype(np.float64)
    span = max(1 / near - 1 / far, 1e-12)
    painted = _colormap((inverse - 1 / far) / span, cv2.COLORMAP_TURBO)
    painted[~is_known] = 28
    return painted


def paint_relevancy(relevancy: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Paint relevancy [H, W] over the grey photograph: 0 black, 0.5 (like "object") red, 1 gold.

    The scale is fixed: a colour means the same in every picture.
    """
    heat = _colormap(relevancy, cv2.COLORMAP_INFERNO).astype(np.float64)
    grey = _grey(image)[..., None]
    return np.clip(0.72 * heat + 0.34 * grey, 0, 255).astype(np.uint8)


def paint_relevancy_range(relevancy: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Paint relevancy [H, W], stretched to its range, over the grey photograph, with a scale.

    The lower half of the range is grey: colours mark where a text fits better than elsewhere.
    Constant relevancy is grey. Pixels of 0, where nothing is rendered, are ignored.
    """
    grey = np.repeat(0.8 * _grey(image)[..., None], 3, -1)
    positive = relevancy[relevancy > 0].astype(np.float64)
    low, high = (float(positive.min()), float(positive.max())) if positive.size else (0.0, 0.0)
    if high - low < 1e-6:
        return grey.astype(np.uint8)
    share = np.clip((relevancy.astype(np.float64) - low) / (high - low), 0, 1)
    bar = np.linspace(0, 1, 256)[None]
    return _with_scale(_paint_upper_half(share, grey), low, high, _paint_upper_half(bar, 110))


def _paint_upper_half(share: np.ndarray, ground: np.ndarray | float) -> np.ndarray:
    """Paint shares [H, W] of a range from purple (0.5) to yellow (1) over grey levels."""
    weight = np.clip((share - 0.5) / 0.15, 0, 0.82)[..., None]
    painted = (1 - weight) * ground + weight * _colormap(1.5 * share - 0.5, cv2.COLORMAP_INFERNO)
    return np.clip(painted, 0, 255).astype(np.uint8)


def _with_scale(image: np.ndarray, low: float, high: float, colours: np.ndarray) -> np.ndarray:
    """Return a copy with a labelled colour bar uint8 [1, 256, 3] at the bottom left."""
    height, width = image.shape[:2]
    size = max(9, round(width / 24))
    font = ImageFont.load_default(size=size)
    texts = f"{low:.2f}", f"{high:.2f}"
    bar_width, pad = round(width / 4), max(2, size // 3)
    first, second = (round(font.getlength(text)) for text in texts)
    box = bar_width + first + second + 4 * pad, size + 2 * pad
    if box[0] > width or box[1] > height:
        return image
    sheet = Image.fromarray(image)
    draw = ImageDraw.Draw(sheet)
    top = height - box[1]
    draw.rectangle((0, top, box[0], height), fill=(20, 22, 28))
    bar = cv2.resize(colours, (bar_width, max(1, size // 2)), interpolation=cv2.INTER_NEAREST)
    sheet.paste(Image.fromarray(bar), (2 * pad + first, top + (box[1] - len(bar)) // 2))
    for left, text in zip((pad, 3 * pad + first + bar_width), texts, strict=True):
        middle = top + box[1] / 2
        draw.text((left, middle), text, fill=(255, 255, 255), font=font, anchor="lm")
    return np.asarray(sheet)


@dataclass(frozen=True, eq=False)
class Region:
    """A region of an image, bool [H, W], and its caption; ``id`` determines the colour."""

    caption: str
    mask: np.ndarray
    id: int


def draw_captions(image: np.ndarray, regions: Sequence[Region], size: int) -> np.ndarray:
    """Return a copy with each caption at the widest part of its region, without overlap.

    ``size`` is the font size in pixels. Empty regions have no caption.
    """
    sheet = Image.fromarray(image)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=size)
    height, width = image.shape[:2]
    free = np.ones((height, width), bool)
    for region in sorted(regions, key=lambda region: int(region.mask.sum())):
        if not region.mask.any():
            continue
        box_height, box_width = size * 1.5, font.getlength(region.caption) + size
        uncovered = region.mask & free
        inside = uncovered if uncovered.any() else region.mask
        distance = cv2.distanceTransform(np.pad(inside.astype(np.uint8), 1), cv2.DIST_L2, 3)
        row, column = np.unravel_index(int(distance[1:-1, 1:-1].argmax()), inside.shape)
        x = min(max(float(column), box_width / 2), max(width - box_width / 2, box_width / 2))
        y = min(max(float(row), box_height / 2), max(height - box_height / 2, box_height / 2))
        box = x - box_width / 2, y - box_height / 2, x + box_width / 2, y + box_height / 2
        colour = _region_colour(region)
        draw.rounded_rectangle(box, box_height / 4, fill=(20, 22, 28), outline=colour, width=2)
        draw.text((x, y), region.caption, fill=(255, 255, 255), font=font, anchor="mm")
        # Captions of other regions must not overlap: block the centres of such boxes.
        left, top = max(0, round(x - box_width)), max(0, round(y - 1.7 * box_height))
        free[top : round(y + 1.7 * box_height), left : round(x + box_width)] = False
    return np.asarray(sheet)


def _region_colour(region: Region) -> tuple[int, int, int]:
    red, green, blue = label_colours(np.array(region.id)).tolist()
    return red, green, blue


def draw_regions(image: np.ndarray, regions: Sequence[Region], size: int) -> np.ndarray:
    """Draw regions in colour, with outline and caption; the rest is grey and dim."""
    nothing = np.zeros(image.shape[:2], bool)
    out = spotlight(image, np.any([nothing, *(region.mask for region in regions)], axis=0))
    for region in sorted(regions, key=lambda region: -int(region.mask.sum())):
        colour = _region_colour(region)
        out[region.mask] = (0.78 * image[region.mask] + 0.22 * np.array(colour)).astype(np.uint8)
        out = draw_outline(out, region.mask, colour)
    return draw_captions(out, regions, size)


def number_objects(labels: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return :func:`paint_labels` with the id of each object as caption."""
    ids = [int(number) for number in np.unique(labels) if number]
    regions = [Region(str(number), labels == number, number) for number in ids]
    return draw_captions(paint_labels(labels, image), regions, max(8, round(image.shape[1] / 48)))


def draw_answer(
    relevancy: np.ndarray,
    mask: np.ndarray | None,
    point: tuple[float, float] | None,
    truth: np.ndarray,
    image: np.ndarray,
) -> dict[str, np.ndarray]:
    """Draw ``relevancy`` and ``mask`` of an answer, with its point and the outline of the truth."""
    predicted = np.zeros(truth.shape, bool) if mask is None else mask
    painted = paint_relevancy_range(relevancy, image)
    answer = draw_outline(spotlight(image, predicted), predicted, PREDICTED_COLOUR)
    return {
        kind: draw_point(draw_outline(picture, truth, TRUE_COLOUR), point)
        for kind, picture in (("relevancy", painted), ("mask", answer))
    }


def spotlight(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the photograph with everything outside ``mask`` grey and dim."""
    dim = np.repeat((0.38 * _grey(image))[..., None], 3, -1)
    return np.where(mask[..., None], image, dim).astype(np.uint8)


def draw_outline(image: np.ndarray, mask: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Return a copy with the outline of ``mask`` and a dark rim, visible on any background."""
    out = image.copy()
    contours, width = _contours(mask), max(2, round(image.shape[1] / 290))
    cv2.drawContours(out, contours, -1, (0, 0, 0), width + 1, cv2.LINE_AA)
    cv2.drawContours(out, contours, -1, colour, width, cv2.LINE_AA)
    return out


def draw_dashed_outline(
    image: np.ndarray, mask: np.ndarray, colour: tuple[int, int, int]
) -> np.ndarray:
    """Return a copy with a dashed outline of an uncertain ``mask`` in ``colour`` and black."""
    out = image.copy()
    dash = max(4, round(image.shape[1] / 80))
    for contour in _contours(mask):
        on = np.arange(len(contour)) // dash % 2 == 0
        for chosen, paint in ((on, colour), (~on, (0, 0, 0))):
            column, row = contour[chosen, 0].T
            out[row, column] = paint
    return out


def _contours(mask: np.ndarray) -> Sequence[np.ndarray]:
    return cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)[0]


def draw_point(image: np.ndarray, point: tuple[float, float] | None) -> np.ndarray:
    """Return a copy with a ringed dot at ``point`` (x, y); the image itself for no point."""
    if point is None:
        return image
    out = image.copy()
    centre = (int(point[0]), int(point[1]))
    radius = max(3, round(image.shape[1] / 90))
    for rim, colour in ((3, (0, 0, 0)), (2, (255, 255, 255)), (0, POINT_COLOUR)):
        cv2.circle(out, centre, radius + rim, colour, -1, cv2.LINE_AA)
    return out


def cut_out(
    images: Sequence[np.ndarray],
    labels: Sequence[np.ndarray] | np.ndarray,
    ids: np.ndarray,
    boxes: np.ndarray,
) -> list[np.ndarray]:
    """Crop each of N objects from the one of V images in which its box is largest.

    ``labels`` are the object ids of the images' pixels; other pixels are pale. ``boxes`` [N, V, 4]
    are the first column and row and those after the last, as in a memory bank.
    """
    views = (boxes[..., 2:] - boxes[..., :2]).prod(-1).argmax(1)
    cuts = []
    for number, object_boxes, view in zip(ids, boxes, views, strict=True):
        x0, y0, x1, y1 = object_boxes[view]
        cut, inside = images[view][y0:y1, x0:x1], labels[view][y0:y1, x0:x1] == number
        cuts.append(np.where(inside[..., None], cut, 255 - (255 - cut) // 4))
    return cuts


def contact_sheet(tiles: Sequence[tuple[str, np.ndarray]], side: int, columns: int) -> np.ndarray:
    """Arrange images of any size in rows of squares, each with its caption, truncated to the width.

    The square of an empty image is empty.
    """
    gap, band = 8, 18
    size = columns * (side + gap) + gap, -(-len(tiles) // columns) * (side + band + gap) + gap
    panels, captions = [], []
    for k, (caption, image) in enumerate(tiles):
        left, top = gap + k % columns * (side + gap), gap + k // columns * (side + band + gap)
        captions.append((caption, side, (left, top + side + 1)))
        if image.size:
            scale = side / max(image.shape[:2])
            fitted = [max(1, round(n * scale)) for n in image.shape[1::-1]]
            small = cv2.resize(image, fitted, interpolation=cv2.INTER_AREA)
            panels.append((small, (left, top)))
    return _sheet(size, panels, captions, 12)


def side_by_side(panels: Sequence[tuple[str, np.ndarray]]) -> np.ndarray:
    """Arrange images in a row, scaled to the height of the first, each with its caption below.

    A caption that is too long is truncated.
    """
    height, gap, band = panels[0][1].shape[0], 12, 34
    placed, captions, left = [], [], gap
    for caption, image in panels:
        width = round(image.shape[1] * height / image.shape[0])
        placed.append((cv2.resize(image, (width, height)), (left, gap)))
        captions.append((caption, width, (left + 1, gap + height + 6)))
        left += width + gap
    return _sheet((left, height + gap + band), placed, captions, 17)


def with_legend(image: np.ndarray, entries: Sequence[tuple[np.ndarray, str]]) -> np.ndarray:
    """Return a copy with a legend below: a swatch of each colour uint8 [3] and its meaning."""
    gap, side, row_height = 12, 16, 26
    height, width = image.shape[:2]
    font = ImageFont.load_default(size=17)
    entry_width = max(font.getlength(text) for _, text in entries) + side + 3 * gap
    columns = max(1, int((width - gap) // entry_width))
    panels, captions = [(image, (0, 0))], []
    for k, (colour, text) in enumerate(entries):
        left, top = gap + int(k % columns * entry_width), height + k // columns * row_height
        swatch = np.full((side + 1, side + 1, 3), CAPTION_COLOUR, np.uint8)
        swatch[1:-1, 1:-1] = colour
        panels.append((swatch, (left, top)))
        captions.append((text, entry_width, (left + side + 8, top - 2)))
    size = width, height + -(-len(entries) // columns) * row_height + gap
    return _sheet(size, panels, captions, 17)


def _sheet(
    size: tuple[int, int],
    panels: Sequence[tuple[np.ndarray, tuple[int, int]]],
    captions: Sequence[tuple[str, float, tuple[int, int]]],
    font_size: int,
) -> np.ndarray:
    """Place images, and captions of at most a width, by their upper left corners on white."""
    sheet = Image.new("RGB", size, "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=font_size)
    for image, place in panels:
        sheet.paste(Image.fromarray(image), place)
    for caption, width, place in captions:
        text = caption
        while font.getlength(text) > width and len(text) > 1:
            text = f"{text.removesuffix('…')[:-1]}…"
        draw.text(place, text, fill=CAPTION_COLOUR, font=font)
    return np.asarray(sheet)


def reduce_width(image: np.ndarray, width: int) -> np.ndarray:
    """Reduce an image to ``width`` pixels if it is wider."""
    if image.shape[1] <= width:
        return image
    height = round(image.shape[0] * width / image.shape[1])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def encode_jpeg(image: np.ndarray, width: int) -> bytes:
    """Encode an image as JPEG, at most ``width`` pixels wide, without chroma subsampling."""
    out = io.BytesIO()
    Image.fromarray(reduce_width(image, width)).save(out, "JPEG", quality=86, subsampling=0)
    return out.getvalue()


def encode_png(image: np.ndarray) -> bytes:
    """Encode a uint8 RGB image or a bool mask (one bit per pixel) as PNG."""
    out = io.BytesIO()
    Image.fromarray(image).save(out, "PNG", compress_level=6)
    return out.getvalue()


def _grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64)


def _colormap(values: np.ndarray, name: int) -> np.ndarray:
    index = np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(index, name)[..., ::-1])
