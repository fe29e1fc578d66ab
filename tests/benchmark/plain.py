"""Reference scores from their definitions: sets, loops and SciPy, without code of the library."""

import math

import numpy as np
from scipy import ndimage


def iou(a, b):
    union = np.logical_or(a, b).sum()
    return np.logical_and(a, b).sum() / union if union else 1.0


def boundary_iou(a, b):
    """Cheng et al. 2021: eroded pixel by pixel, d times, with nothing beyond the image."""
    height, width = a.shape
    times = max(1, round(0.02 * math.sqrt(height**2 + width**2)))

    def rim(mask):
        square = np.ones((3, 3), bool)
        return mask & ~ndimage.binary_erosion(mask, square, iterations=times, border_value=0)

    return iou(rim(a), rim(b))


def inside_boxes(points, boxes):
    return any(x0 <= x <= x1 and y0 <= y <= y1 for x, y in points for x0, y0, x1, y1 in boxes)


def langsplat(relevancy, side):
    """Mask, tied pixels (x, y) of the peak, and the one nearest their middle."""
    raw = relevancy.astype(np.float64)
    if not (raw > 0).any():
        return np.zeros(raw.shape, bool), [], None
    raw = np.where(raw > 0, raw, raw[raw > 0].min())
    smooth = ndimage.uniform_filter(raw, side, mode="mirror")
    blend = (smooth + raw) / 2
    stretched = (blend - blend.min()) / (blend.max() - blend.min() + 1e-9) * 2 - 1
    above = np.clip(stretched, 0, 1) > 0.4
    votes, voters = np.zeros(raw.shape, int), np.zeros(raw.shape, int)
    height, width = raw.shape
    for dy in range(-3, 4):
        for dx in range(-3, 4):
            # Voters are all pixels but those of the last row and column.
            y0, y1 = max(0, -dy), min(height, height - 1 - dy)
            x0, x1 = max(0, -dx), min(width, width - 1 - dx)
            if y0 < y1 and x0 < x1:
                votes[y0:y1, x0:x1] += above[y0 + dy : y1 + dy, x0 + dx : x1 + dx]
                voters[y0:y1, x0:x1] += 1
    # SciPy's running sums are off by some 1e-15.
    ys, xs = np.nonzero(smooth >= smooth.max() - 1e-9)
    middle = xs.mean(), ys.mean()
    near = min(range(len(xs)), key=lambda i: (xs[i] - middle[0]) ** 2 + (ys[i] - middle[1]) ** 2)
    point = (int(xs[near]), int(ys[near]))
    return 2 * votes > voters, list(zip(xs.tolist(), ys.tolist(), strict=True)), point


def scores(protocol, frame, k):
    """Score query ``k`` of a frame by ``protocol``, in plain loops."""
    answer, truth, boxes = frame.answers[k], frame.masks[k], frame.boxes[k]
    region, point, mask = frame.labels == k + 1, answer.point, answer.mask
    if protocol == "3d-ovs":
        bits = np.stack(frame.masks)
        labelled = np.stack([frame.labels == j + 1 for j in range(len(bits))])
        right = (bits == labelled).all(0) & labelled.any(0)
        overlap = {"class_iou": iou(region, truth), "boundary_iou": boundary_iou(region, truth)}
        return {**overlap, "accuracy": right.mean()}
    result = {}
    if protocol == "highest-pixel":
        best, (h, w) = answer.relevancy.max(), truth.shape
        pixels = [(x, y) for y in range(h) for x in range(w)]
        peak = [(x, y) for x, y in pixels if 0 < answer.relevancy[y, x] == best]
        point = peak[0] if peak else None
    elif protocol.startswith("langsplat"):
        side = 30 if protocol == "langsplat" else round(30 * truth.shape[1] / 988)
        mask, peak, point = langsplat(answer.relevancy, side)
    if protocol == "slgaussian":
        result["class_iou"] = iou(region, truth)
    else:
        result["hit_peak"] = inside_boxes(peak, boxes)
    if protocol != "highest-pixel":
        result |= {"iou": iou(mask, truth), "boundary_iou": boundary_iou(mask, truth)}
    if not protocol.startswith("langsplat"):
        result["hit_mask"] = point is not None and bool(truth[point[1], point[0]])
    return result | {"hit_box": point is not None and inside_boxes([point], boxes)}
