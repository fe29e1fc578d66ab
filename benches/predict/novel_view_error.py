"""Novel-view table of the plane sweep: its Gaussians at the target against the real photograph.

``python -m benches.predict.novel_view_error [DATA]``: every scene of DATA, a nerfstudio folder with
``pairs.json`` (scene -> context, target) and sensor depth; without DATA a procedural room. Three
methods:

- ``gaussians``: rendered; what no Gaussian covers fades to black.
- ``warped``: a control without Gaussians of its own. The depth of the target is the median depth
  of the rendering, holes taken from the nearest pixel; every target pixel is the mean of what the
  context photographs show there, bilinear, of those whose depth map agrees within 6 %, else of
  those it falls into, else of both continued at their border. Their exposures are made equal by
  the median ratio per channel.
- ``nearest``: the photograph taken closest to the target, as it is.

PSNR in dB and SSIM (Wang et al. 2004: Gaussian window, sigma 1.5) of 8-bit RGB; over the whole
image, and over the pixels that can be known: those whose true depth puts them inside a context
photograph. Their share, and the share of pixels left open (alpha below one half), stand beside.
"""

import sys

import cv2
import numpy as np

import slgaussian.kernels.threads
from benches.common.photograph_pairs import load_samples, photographs
from slgaussian.benchmark.metrics import psnr, ssim_with_map
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import Render, rasterize
from slgaussian.scene import Camera, Sample, View
from slgaussian.semantic.decode import VISIBLE


def project_inside(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels, depths, and which points [H, W, 3] fall inside the image."""
    pixels, z = camera.project(points)
    inside = (z > 0) & (pixels >= 0).all(-1) & (pixels < (camera.width, camera.height)).all(-1)
    return pixels, z, inside


def knowable(target: View, context: tuple[View, ...]) -> np.ndarray:
    points = target.camera.unproject(target.depth)
    inside = [project_inside(view.camera, points)[2] for view in context]
    return np.any(inside, 0) & (target.depth > 0)


def drawn(render: Render) -> np.ndarray:
    alpha = np.maximum(render.alpha.numpy(), VISIBLE)[..., None]
    return np.rint((render.values.numpy() / alpha).clip(0, 1) * 255).astype(np.uint8)


def nearest(sample: Sample) -> np.ndarray:
    place = sample.targets[0].camera.center
    return min(sample.context, key=lambda v: np.linalg.norm(v.camera.center - place)).image


def warped(sample: Sample, gaussians: Gaussians, render: Render) -> np.ndarray:
    depth = render.median.numpy().astype(np.float64)
    _, label = cv2.distanceTransformWithLabels(
        (depth == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.ones(label.max() + 1)
    of_label[label[depth > 0]] = depth[depth > 0]
    points = sample.targets[0].camera.unproject(of_label[label])
    depths = source_depths(gaussians, [view.camera for view in sample.context])
    images, insides, agreeing = [], [], []
    for view, known in zip(sample.context, depths, strict=True):
        pixels, z, inside = project_inside(view.camera, points)
        x, y = (pixels - 0.5).astype(np.float32).transpose(2, 0, 1)
        border = cv2.BORDER_REPLICATE
        images.append(
            cv2.remap(view.image, x, y, cv2.INTER_LINEAR, borderMode=border).astype(np.float64)
        )
        there = cv2.remap(known, x, y, cv2.INTER_NEAREST, borderMode=border)
        insides.append(inside)
        agreeing.append(inside & (np.abs(there - z) < 0.06 * z))
    both = agreeing[0] & agreeing[1]
    if both.any():
        ratio = np.median((images[0][both] + 1) / (images[1][both] + 1), axis=0)
        images = [images[0] / np.sqrt(ratio), images[1] * np.sqrt(ratio)]
    weights = np.where(np.any(agreeing, 0), agreeing, np.where(np.any(insides, 0), insides, 1.0))
    mixed = (np.array(images) * weights[..., None]).sum(0) / weights.sum(0)[..., None]
    return np.rint(mixed.clip(0, 255)).astype(np.uint8)


def scores(image: np.ndarray, truth: np.ndarray, known: np.ndarray) -> list[float]:
    similarity, similarities = ssim_with_map(image, truth)
    return [
        psnr(image, truth),
        similarity,
        psnr(image[known], truth[known]),
        similarities[known].mean(),
    ]


def main() -> None:
    slgaussian.kernels.threads.limit()
    rows: dict[str, list[list[float]]] = {"gaussians": [], "warped": [], "nearest": []}
    shares = []
    print(" " * 16 + "".join(f"| {name:27s}" for name in rows) + "| known  open")
    print(" " * 16 + "|  whole        known        " * 3)
    line = "| {:5.2f} {:.3f}  {:5.2f} {:.3f}  "
    data = photographs(sys.argv[1]) if len(sys.argv) > 1 else None
    for name, sample in load_samples(data).items():
        target = sample.targets[0]
        gaussians = PlaneSweep()(sample)
        render = rasterize(gaussians, gaussians.colors(), target.camera, median=True)
        known = knowable(target, sample.context)
        pictures = drawn(render), warped(sample, gaussians, render), nearest(sample)
        for method, picture in zip(rows, pictures, strict=True):
            rows[method].append(scores(picture, target.image, known))
        shares.append([known.mean(), (render.alpha.numpy() < VISIBLE).mean()])
        cells = "".join(line.format(*found[-1]) for found in rows.values())
        print(f"{name:16s}{cells}| {shares[-1][0]:.3f} {shares[-1][1]:.3f}", flush=True)
    cells = "".join(line.format(*np.mean(found, 0)) for found in rows.values())
    print("mean            " + cells + "| {:.3f} {:.3f}".format(*np.mean(shares, 0)))


if __name__ == "__main__":
    main()
