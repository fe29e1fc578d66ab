"""What SAM and SAM 2 must find, so that random or damaged weights are found.

A disc is drawn in images of several sizes and pointed at. Any real one outlines it nearly to the
pixel, answers the same prompt with the same masks, and another prompt with others. The bounds were
set without real weights at hand, far below what is published.
"""

from __future__ import annotations

import time

import cv2
import numpy as np
import torch

from slgaussian.kernels.threads import inside
from slgaussian.masks.prompted import AutomaticProposer
from slgaussian.parts.finding import Finding, Findings

SIZES = ((240, 320), (330, 250), (256, 256))
"""Heights and widths of the images: lying, standing, square."""

FOUND = 0.8
"""IoU of the disc with the best of the three masks of a point in it, at least."""

APART = 0.5
"""IoU of the disc with the best mask of a point beside it, at most, by the model's own choice."""

SAME = 0.999
"""Pixels in which a point's masks, asked alone and with others, agree, at least."""

POINTS = 16
"""Points along each side, for the time that an image takes."""

DOUBT = "are these weights random or damaged?"


def findings(proposer: AutomaticProposer) -> Findings:
    """Ask a SAM or SAM 2 for a disc; one finding a question, and one about its cost."""
    name = proposer.FAMILY.part
    quiet = torch.backends.cudnn.flags(benchmark=False)
    with torch.inference_mode(), quiet, inside(proposer.network):
        ious, others, agree, same, finite, encoding = [], [], [], True, True, []
        for size in SIZES:
            image, disc, inner, outer = drawn_disc(size)
            points = np.array([inner, outer], np.float64)
            start = time.perf_counter()
            prompted = proposer.encode(image)
            logits, predicted = (t.cpu() for t in prompted.segment(points[:1]))
            encoding.append(time.perf_counter() - start)
            again, _ = prompted.segment(points[:1])
            both, told = prompted.segment(points)
            masks, together, beside = (
                (prompted.enlarge(found) > 0).cpu().numpy() for found in (logits[0], *both)
            )
            finite &= all(bool(t.isfinite().all()) for t in (logits, predicted, both, told))
            same &= torch.equal(logits, again.cpu())
            agree.append(float((masks == together).mean()))
            ious.append(max(_iou(mask, disc) for mask in masks))
            others.append(_iou(beside[int(told[1].argmax())], disc))
        batch = np.linspace((4.0, 4.0), np.array(SIZES[-1]) - 4, proposer.batch)
        start = time.perf_counter()
        prompted.segment(batch)[0].cpu()
        point = (time.perf_counter() - start) / len(batch)
    if not finite:
        yield Finding(name, f"masks: hold NaN or infinity; {DOUBT}", False)
        return
    shown = ", ".join(f"{width}x{height}" for height, width in SIZES)
    good = same and min(agree) >= SAME
    said = f"masks: finite; the same prompt twice gives {'the same' if same else 'other'} masks, "
    said += f"and with others {100 * min(agree):.2f} % of their pixels"
    if not good:
        said += f", expected the same and {100 * SAME:.1f} %; the device computes wrongly"
    yield Finding(name, said, good)
    good = min(ious) >= FOUND
    said = f"disc: pointed at in images of {shown}, found with IoU {_listed(ious)}"
    said += f", expected {FOUND}"
    yield Finding(name, said + ("" if good else f"; {DOUBT}"), good)
    good = max(others) <= APART
    said = f"point: one beside the disc gives a mask with IoU {_listed(others)} to it"
    said += f", expected at most {APART}"
    yield Finding(name, said + ("" if good else f"; it does not heed its prompt: {DOUBT}"), good)
    image_time = min(encoding) + POINTS**2 * point
    said = f"cost: {min(encoding):.2f} s to encode an image and {point:.3f} s a point, so "
    said += f"{image_time:.1f} s an image with {POINTS} x {POINTS} points"
    yield Finding(name, said, None)


def drawn_disc(
    size: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, tuple[float, float], tuple[float, float]]:
    """An image of a disc, the disc, and a point in it and one beside it.

    Returns
    -------
    image : uint8 [H, W, 3]
        An orange disc on a floor that gets lighter downwards, with the noise of a camera.
    disc : bool [H, W]
    inner, outer : (float, float)
        x and y.
    """
    height, width = size
    rng = np.random.default_rng(0)
    shade = np.linspace(70, 130, height)[:, None, None] * np.array([0.8, 0.95, 1.0])
    image = np.broadcast_to(shade, (height, width, 3)).copy()
    centre, radius = (int(0.6 * width), int(0.55 * height)), min(size) // 5
    disc = np.zeros(size, np.uint8)
    cv2.circle(disc, centre, radius, 1, -1)
    image[disc > 0] = (225, 120, 30)
    image += rng.normal(0, 3, image.shape)
    outer = (0.12 * width, 0.15 * height)
    return np.rint(image.clip(0, 255)).astype(np.uint8), disc > 0, centre, outer


def _iou(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / max(1, (one | other).sum()))


def _listed(numbers: list[float]) -> str:
    return ", ".join(f"{number:.2f}" for number in numbers)
