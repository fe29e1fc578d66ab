"""Errors of the plane sweep: new views against photographs, and depth against a sensor.

    python -m benches.predict.novel_view_error DATA [-o docs/measured]

DATA holds ``office``, ``places`` and ``things``: nerfstudio folders with ``pairs.json`` (scene ->
context, target); the office has sensor depth. Rooms are procedural, and the motorcycle pair ships
with scikit-image. Methods:

- ``gaussians``: rendered Gaussians; uncovered areas fade to black.
- ``warped``: a control that warps the context photographs by the rendered median depth, with holes
  filled from the nearest pixel. A target pixel is the mean of bilinear samples of the photographs
  whose depth map agrees within 6 %; without any, of those that contain the point; without any, of
  both, extended at the border. Exposures are equalised by the median ratio per channel.
- ``nearest``: the unchanged photograph whose camera is closest to the target.

PSNR in dB and SSIM (Wang et al. 2004: Gaussian window, sigma 1.5) of 8-bit RGB. The PSNR of
``gaussians`` is also given at borders, in a band 8 px wide along steps of the rendered depth.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder, load_samples
from benches.scores.score_floors import motorcycle
from slgaussian.benchmark.metrics import psnr, ssim
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.kernels import threads
from slgaussian.labels import MIN_WEIGHT
from slgaussian.predict.planesweep import PlaneSweep
from slgaussian.rasterize import Render, rasterize
from slgaussian.scene import Camera, Sample, View

ROOMS = 8

STEP = 1.1
BAND = 4
"""Smallest ratio of neighbouring depths at a step, and half the width of the band around it in
pixels."""


def border_band(depth: np.ndarray) -> np.ndarray:
    """Mask the pixels near a step of a depth map [H, W] in which 0 is unknown, bool [H, W]."""
    far = cv2.dilate(depth, np.ones((3, 3)))
    near = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), np.ones((3, 3)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * BAND + 1, 2 * BAND + 1))
    return cv2.dilate((far > STEP * near).astype(np.uint8), disc) > 0


def project_inside(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pixels and depths of points [H, W, 3], and which are inside the image."""
    pixels, z = camera.project(points)
    return pixels, z, camera.shows(pixels, z)


def depth_errors(view: View, second: View, depth: np.ndarray) -> tuple[float, float, float]:
    """Return mean and median relative error and share within 25 %, where both views see it."""
    _, _, inside = project_inside(second.camera, view.camera.unproject(view.depth))
    valid = (view.depth > 0) & inside
    ratio = depth[valid] / view.depth[valid]
    off, close = np.abs(ratio - 1), np.maximum(ratio, 1 / ratio) < 1.25
    return float(off.mean()), float(np.median(off)), float(close.mean())


def draw(render: Render) -> np.ndarray:
    alpha = np.maximum(render.alpha.numpy(), MIN_WEIGHT)[..., None]
    return np.rint((render.values.numpy() / alpha).clip(0, 1) * 255).astype(np.uint8)


def nearest(sample: Sample) -> np.ndarray:
    place = sample.targets[0].camera.center
    return min(sample.context, key=lambda v: np.linalg.norm(v.camera.center - place)).image


def warp(sample: Sample, gaussians: Gaussians, render: Render) -> np.ndarray:
    depth = render.median.numpy().astype(np.float64)
    _, label = cv2.distanceTransformWithLabels(
        (depth == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.ones(label.max() + 1)
    of_label[label[depth > 0]] = depth[depth > 0]
    points = sample.targets[0].camera.unproject(of_label[label])
    depths = source_depths(gaussians, [view.camera for view in sample.context])
    images, insides, agreeing = [], [], []
    for view, depth_map in zip(sample.context, depths, strict=True):
        pixels, z, inside = project_inside(view.camera, points)
        x, y = (pixels - 0.5).astype(np.float32).transpose(2, 0, 1)
        border = cv2.BORDER_REPLICATE
        images.append(
            cv2.remap(view.image, x, y, cv2.INTER_LINEAR, borderMode=border).astype(np.float64)
        )
        observed = cv2.remap(depth_map, x, y, cv2.INTER_NEAREST, borderMode=border)
        insides.append(inside)
        agreeing.append(inside & (np.abs(observed - z) < 0.06 * z))
    both = agreeing[0] & agreeing[1]
    if both.any():
        ratio = np.median((images[0][both] + 1) / (images[1][both] + 1), axis=0)
        images = [images[0] / np.sqrt(ratio), images[1] * np.sqrt(ratio)]
    weights = np.where(np.any(agreeing, 0), agreeing, np.where(np.any(insides, 0), insides, 1.0))
    mixed = (np.array(images) * weights[..., None]).sum(0) / weights.sum(0)[..., None]
    return np.rint(mixed.clip(0, 255)).astype(np.uint8)


def sharpness(image: np.ndarray, truth: np.ndarray) -> float:
    """Compute the mean absolute Laplacian relative to the truth, both uint8 [H, W, 3]."""
    greys = (cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float64) for rgb in (image, truth))
    ours, theirs = (np.abs(cv2.Laplacian(grey, cv2.CV_64F)).mean() for grey in greys)
    return float(ours / theirs)


def of_pair(sample: Sample) -> dict[str, float]:
    """Compute scores of a pair by ``method_metric``, and depth errors if it has sensor depth."""
    target = sample.targets[0]
    gaussians = PlaneSweep()(sample)
    render = rasterize(gaussians, gaussians.colours(), target.camera, median=True)
    pictures = {
        "gaussians": draw(render),
        "warped": warp(sample, gaussians, render),
        "nearest": nearest(sample),
    }
    row = {}
    for method, picture in pictures.items():
        row[f"{method}_psnr"] = psnr(picture, target.image)
        row[f"{method}_ssim"] = ssim(picture, target.image)
        row[f"sharp_{method}"] = sharpness(picture, target.image)
    band = border_band(render.median.numpy())
    for part, mask in (("border", band), ("elsewhere", ~band)):
        row[part] = psnr(pictures["gaussians"][mask], target.image[mask])
    row["ahead"] = row["gaussians_psnr"] - row["warped_psnr"]
    a, b = sample.context
    if a.depth is not None and b.depth is not None:
        depths = source_depths(gaussians, [a.camera, b.camera])
        both = [depth_errors(a, b, depths[0]), depth_errors(b, a, depths[1])]
        row |= dict(zip(("abs_rel", "median", "close"), np.mean(both, 0), strict=True))
    return row


def average(name: str, rows: Sequence[dict[str, float]]) -> dict[str, object]:
    """Return a row of the tables: means over pairs."""
    means = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    ahead = sum(row["ahead"] > 0 for row in rows)
    return {"set": name, "pairs": len(rows), "pairs_ahead": ahead, **means}


VIEWS = {
    "set": ("set", str),
    "pairs": ("pairs", "d"),
    "gaussians_psnr": ("gaussians: PSNR, dB", ".2f"),
    "border": ("at borders", ".2f"),
    "elsewhere": ("elsewhere", ".2f"),
    "gaussians_ssim": ("SSIM", ".3f"),
    "sharp_gaussians": ("sharpness", ".2f"),
    "warped_psnr": ("warped: PSNR, dB", ".2f"),
    "warped_ssim": ("SSIM", ".3f"),
    "sharp_warped": ("sharpness", ".2f"),
    "nearest_psnr": ("nearest: PSNR, dB", ".2f"),
    "nearest_ssim": ("SSIM", ".3f"),
    "ahead": ("gaussians less warped, dB", "+.2f"),
    "pairs_ahead": ("pairs ahead of warped", "d"),
}
DEPTHS = {
    "set": ("set", str),
    "abs_rel": ("mean relative error", ".3f"),
    "median": ("median", ".3f"),
    "close": ("share within 25 %", ".3f"),
}


def main() -> None:
    arguments = parser(__doc__, "results.md")
    arguments.add_argument("data", type=data_folder("office/pairs.json", "places", "things"))
    args = arguments.parse_args()
    threads.limit()
    sets = {"rooms": [load_samples(None, seed=seed)["procedural"] for seed in range(ROOMS)]}
    for name in ("office", "places", "things"):
        files = sorted(args.data.glob(f"{name}/**/pairs.json"))
        sets[name] = [sample for file in files for sample in load_samples(file.parent).values()]
    rows = [
        average(name, [of_pair(sample) for sample in samples]) for name, samples in sets.items()
    ]
    stereo = motorcycle(seed=0)
    publish(
        args.out,
        "results.md",
        "python -m benches.predict.novel_view_error DATA",
        table(rows, VIEWS),
        table([row for row in rows if "abs_rel" in row], DEPTHS),
        f"Of the motorcycle pair, at full size, {stereo['bad2']:.2%} of the pixels with true depth "
        f"are more than 2 px off, and depth is off by {stereo['abs_rel']:.2%} on average.",
    )


if __name__ == "__main__":
    main()
