"""Seconds and memory of the suppression of overlapping masks, for ``mask_quality.py``.

For each set of masks, 300 of 720x960 unless it says otherwise: the least wall and CPU seconds of
three calls, the memory beyond that of the masks (the process's peak less what it had), and the same
for a plain product of all pixels in float32, which gives the same intersections. ``blobs`` are like
what SAM proposes in a photograph: smooth, 8 to 300 pixels in radius; ``noise``, of independent
pixels, is the worst case.
"""

import multiprocessing
import time

import cv2
import numpy as np
import torch

from slgaussian.benchmark.resident_memory import held
from slgaussian.kernels import threads
from slgaussian.masks.nms import box_nms, mask_boxes, mask_intersections, mask_nms, mostly_visible

SIZE = (720, 960)
REPEATS = 3


def blobs(count, size=SIZE, seed=0):
    rng = np.random.default_rng(seed)
    masks = np.zeros((count, *size), np.uint8)
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    for mask in masks:
        centre = rng.uniform(0, 1, 2) * size[::-1]
        radius = np.exp(rng.uniform(np.log(8), np.log(300)))
        wave = 1 + 0.3 * np.sin(3 * angle + rng.uniform(0, 6)) + 0.1 * rng.standard_normal(40)
        around = np.stack([np.cos(angle), np.sin(angle)], 1)
        outline = centre + radius * wave[:, None] * around
        cv2.fillPoly(mask, [outline.astype(np.int32)], 1)
    return masks.view(bool)


def noise(count, size=SIZE, seed=0):
    return np.random.default_rng(seed).integers(0, 2, (count, *size), np.uint8).view(bool)


def plain_product(masks, scores):
    flat = torch.from_numpy(masks.reshape(len(masks), -1))
    out = torch.zeros(len(masks), len(masks), dtype=torch.float64)
    for part in flat.split(1 << 15, 1):
        number = part.float()
        out += number @ number.T
    return out.numpy()


SETS = {
    "300 blobs": lambda: blobs(300),
    "300 noise": lambda: noise(300),
    "1000 blobs, 416x576": lambda: blobs(1000, (416, 576)),
}
CALLS = {
    "mask_nms, nested": lambda masks, scores: mask_nms(masks, scores, 0.8, 0.5),
    "box_nms": lambda masks, scores: box_nms(mask_boxes(masks), scores, 0.7),
    "mostly_visible": lambda masks, scores: mostly_visible(masks, 0.8),
    "plain product": plain_product,
}


def measure(name, call, answer):
    """In a fresh process: memory that was used before counts for nothing."""
    threads.limit()
    masks = SETS[name]()
    scores = np.random.default_rng(1).random(len(masks))
    CALLS[call](masks[:2], scores[:2])
    before = held("VmHWM")
    times = []
    for _ in range(REPEATS):
        wall, cpu = time.perf_counter(), time.process_time()
        found = CALLS[call](masks, scores)
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    extra = held("VmHWM") - before
    if call == "plain product" and not np.array_equal(found, mask_intersections(masks)):
        raise SystemExit(f"{name}: intersections differ")
    answer.put((*np.min(times, 0).tolist(), extra / 2**20))


def rows():
    context = multiprocessing.get_context("spawn")
    for name in SETS:
        for call in CALLS:
            answer = context.SimpleQueue()
            process = context.Process(target=measure, args=(name, call, answer))
            process.start()
            process.join()
            if process.exitcode:
                raise SystemExit(process.exitcode)
            wall, cpu, extra = answer.get()
            yield {"masks": name, "call": call, "wall": wall, "cpu": cpu, "extra": extra}
