"""Speed and error of the rasteriser as thresholds, scene, image and channels change.

Every function measures and returns rows: dicts of numbers, times in seconds. Times are medians of
a :func:`paired_times` in which the plain loop of ``plain_loop.py`` takes part.

Errors are those of the whole image, against the cpu backend with nearly nothing cut
(:data:`FINE`). How far that is from the float64 reference, which at 60 ms a pixel and half a
million Gaussians is too slow for an image, :func:`against_reference` measures on windows.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from benches.common.paired_timing import paired_times
from benches.rasterize.plain_loop import splat_in_order
from slgaussian.gaussians import Gaussians
from slgaussian.rasterize import PRESETS, Settings, plan, rasterize
from slgaussian.rasterize.blend import draw
from slgaussian.rasterize.picture import GEOMETRY
from slgaussian.rasterize.project import eye_of, project
from slgaussian.rasterize.tiles import bin_splats
from slgaussian.scene import Camera
from tests.rasterize import hard_cases

DEFAULT = Settings()
NOTHING_CUT = {"alpha_min": 0.0, "sigmas": math.inf, "pass_min": 0.0}
FINE = NOTHING_CUT | {"alpha_min": 2.0**-20}

LOOP, FAST = "plain loop", "fast (alpha_min 1/4096)"
CUTS = {
    "3dgs": PRESETS["3dgs"],
    "alpha_min 1/255": Settings(alpha_min=1 / 255, pass_min=1 / 255),
    "alpha_min 1/512": Settings(alpha_min=1 / 512, pass_min=1 / 512),
    "alpha_min 1/1024": Settings(alpha_min=1 / 1024, pass_min=1 / 1024),
    FAST: DEFAULT,
    "alpha_min 1/65536": Settings(alpha_min=2.0**-16, pass_min=2.0**-16),
}
"""Cut-offs by the name they have in table and plot."""

LOOP_CUTS = {"alpha_min": 1 / 255, "sigmas": 3.0, "pass_min": 1e-4}
"""What is written into the loop of ``plain_loop.py``."""

DENSE = "dense_overlap"
EXACT_PART = 64
COUNT_PARTS = (64, 16, 4, 1)
SCALES = (0.25, 0.5, 1, 2)
CHANNELS = (1, 3, 6, 16, 64, 512)

WINDOW = 8
WINDOWS = ((0.3, 0.4), (0.5, 0.5), (0.7, 0.3), (0.6, 0.8))
"""Left and top corners of the windows, as shares of the image."""


@dataclass(frozen=True, eq=False)
class Subject:
    """What is drawn: ``values`` float32 [N, C] of ``gaussians``, seen by ``camera``.

    ``contexts`` are the cameras whose photographs the Gaussians were predicted from.
    """

    name: str
    gaussians: Gaussians
    values: torch.Tensor
    camera: Camera
    contexts: Sequence[Camera] = ()


def drawn_by_loop(subject: Subject) -> torch.Tensor:
    arrays = subject.gaussians.to_arrays()
    return torch.from_numpy(splat_in_order(arrays, subject.values.numpy(), subject.camera))


def drawn(subject: Subject, settings: Settings | str = "fast") -> torch.Tensor:
    return rasterize(subject.gaussians, subject.values, subject.camera, settings=settings).values


def reference(subject: Subject) -> torch.Tensor:
    made = rasterize(subject.gaussians, subject.values, subject.camera, backend="reference")
    return made.values


def part(subject: Subject, share: int) -> Subject:
    """One Gaussian of every ``share``, drawn at random; the others are left out."""
    generator = torch.Generator().manual_seed(0)
    kept = torch.randperm(len(subject.gaussians), generator=generator)
    kept = kept[: len(kept) // share].sort().values
    return replace(subject, gaussians=subject.gaussians[kept], values=subject.values[kept])


def random_values(n: int, channels: int) -> torch.Tensor:
    """As different from neighbour to neighbour as ID codes can be, float32 in [0, 1]."""
    return torch.rand(n, channels, generator=torch.Generator().manual_seed(0))


def greatest(difference: torch.Tensor) -> float:
    return float(difference.abs().max())


# One scene.


def scene_row(subject: Subject) -> dict:
    """Seconds of all that is done with a scene, and errors of the default settings."""
    gaussians, values, camera = subject.gaussians, subject.values, subject.camera
    leaves = {
        name: getattr(gaussians, name).clone().requires_grad_()
        for name in ("means", "scales", "quats", "opacities")
    }
    free, free_values = replace(gaussians, **leaves), values.clone().requires_grad_()
    upstream = torch.rand(camera.height, camera.width, values.shape[1])

    def both_ways() -> None:
        image = rasterize(free, free_values, camera).values
        torch.autograd.grad(image, [*leaves.values(), free_values], upstream)

    made, three = plan(gaussians, camera), values[:, :3].clone().requires_grad_()
    product = made.render(three)
    spent = paired_times(
        {
            "loop": lambda: drawn_by_loop(subject),
            "fast": lambda: drawn(subject),
            "both_ways": both_ways,
            "plan": lambda: plan(gaussians, camera),
            "product": lambda: made.render(three.detach()),
            "product_back": lambda: torch.autograd.grad(
                product, three, upstream[..., :3], retain_graph=True
            ),
        }
    )
    fine = drawn(subject, replace(DEFAULT, **FINE))
    return {
        "scene": subject.name,
        "gaussians": len(gaussians),
        **spent,
        "ratio": spent["loop"] / spent["fast"],
        "both_ratio": spent["both_ways"] / spent["fast"],
        "greatest": greatest(drawn(subject) - fine),
        "plan_greatest": greatest(product.detach() - fine[..., :3]),
        **against_reference(subject),
    }


def against_reference(subject: Subject) -> dict[str, float]:
    """Greatest errors on the windows, of the default settings and of ``FINE``."""
    settings = {"window_greatest": DEFAULT, "window_fine": replace(DEFAULT, **FINE)}
    worst = dict.fromkeys(settings, 0.0)
    for window in windows(subject):
        true = reference(window)
        for name, chosen in settings.items():
            worst[name] = max(worst[name], greatest(drawn(window, chosen) - true))
    return worst


def windows(subject: Subject) -> Iterator[Subject]:
    camera = subject.camera
    for x, y in WINDOWS:
        corner = round(x * camera.width), round(y * camera.height)
        yield replace(subject, camera=camera.cropped(*corner, WINDOW, WINDOW))


def stages_row(subject: Subject) -> dict:
    """Seconds of the three stages of a picture, and Gaussians listed for a block of pixels."""
    eye = eye_of(subject.camera, DEFAULT)
    geometry = [getattr(subject.gaussians, name).numpy() for name in GEOMETRY]
    values = subject.values.numpy()
    splats, boxes, _ = project(geometry, values, eye)
    bins = bin_splats(boxes, eye.width, eye.height)
    limits = np.float32(DEFAULT.alpha_max), np.float32(DEFAULT.pass_min)
    no_labels = np.empty(0, np.int32)
    scene = (
        splats, boxes, values, bins, eye.width, eye.height, *limits, False,
        no_labels, -1,
    )  # fmt: skip
    spent = paired_times(
        {
            "project": lambda: project(geometry, values, eye),
            "bin": lambda: bin_splats(boxes, eye.width, eye.height),
            "draw": lambda: draw(*scene),
        }
    )
    made = plan(subject.gaussians, subject.camera)
    return spent | {"listed": len(made.members) / (len(made.starts) - 1)}


# Sweeps over one scene.


def threshold_rows(subject: Subject) -> list[dict]:
    """The plain loop, the cut-offs of ``CUTS``, and, of a part of the scene, ``exact``."""
    contenders = {LOOP: lambda: drawn_by_loop(subject)} | {
        name: lambda settings=settings: drawn(subject, settings) for name, settings in CUTS.items()
    }
    spent = paired_times(contenders)
    rows = []
    for name, draw_once in contenders.items():
        settings = CUTS.get(name, DEFAULT)
        error = (draw_once() - drawn(subject, replace(settings, **FINE))).abs()
        if name == LOOP:
            cuts, dense = LOOP_CUTS, loop_on_dense()
        else:
            cuts = {key: getattr(settings, key) for key in NOTHING_CUT}
            dense = hard_cases.measure(DENSE, settings).values
        rows.append(
            {
                "what": name,
                **cuts,
                "seconds": spent[name],
                "ratio": spent[LOOP] / spent[name],
                "greatest": float(error.max()),
                "mean": float(error.mean()),
                "dense": dense,
            }
        )
    return [*rows, exact_row(subject)]


def loop_on_dense() -> float:
    made = hard_cases.case(DENSE)
    # The loop takes quaternions to be normalised.
    unit = replace(made.gaussians, quats=torch.nn.functional.normalize(made.gaussians.quats))
    subject = Subject(DENSE, unit, made.values, made.camera)
    return greatest(drawn_by_loop(subject) - drawn(subject, "exact"))


def exact_row(subject: Subject) -> dict:
    """With nothing cut every Gaussian is listed in every tile: so only a part of the scene."""
    few = part(subject, EXACT_PART)
    spent = paired_times({"loop": lambda: drawn_by_loop(few), "exact": lambda: drawn(few, "exact")})
    errors = torch.stack(
        [(drawn(window, "exact") - reference(window)).abs() for window in windows(few)]
    )
    return {
        "what": f"exact, 1/{EXACT_PART} of scene",
        **NOTHING_CUT,
        "seconds": spent["exact"],
        "ratio": spent["loop"] / spent["exact"],
        "greatest": float(errors.max()),
        "mean": float(errors.mean()),
        "dense": hard_cases.measure(DENSE, "exact").values,
    }


def duel(subject: Subject) -> dict:
    """Seconds of the plain loop and of the default settings, and the error of the latter."""
    spent = paired_times({"loop": lambda: drawn_by_loop(subject), "fast": lambda: drawn(subject)})
    error = greatest(drawn(subject) - drawn(subject, replace(DEFAULT, **FINE)))
    return spent | {"ratio": spent["loop"] / spent["fast"], "greatest": error}


def count_rows(subject: Subject) -> list[dict]:
    parts = [part(subject, share) for share in COUNT_PARTS]
    return [{"gaussians": len(some.gaussians)} | duel(some) for some in parts]


def resolution_rows(subject: Subject) -> list[dict]:
    rows = []
    for scale in SCALES:
        size = round(scale * subject.camera.width), round(scale * subject.camera.height)
        camera = subject.camera.resized(*size)
        row = {"size": "{} x {}".format(*size), "pixels": size[0] * size[1]}
        rows.append(row | duel(replace(subject, camera=camera)))
    return rows


def channel_rows(subject: Subject) -> list[dict]:
    rows = []
    for channels in CHANNELS:
        values = random_values(len(subject.gaussians), channels)
        rows.append({"channels": channels} | duel(replace(subject, values=values)))
    return rows


def hard_case_rows() -> list[dict]:
    """Errors of ``exact`` and ``fast`` on every hard case, against the reference."""
    rows = []
    for name in hard_cases.names():
        row = {"case": name.replace("_", " "), "about": hard_cases.case(name).about}
        for preset in ("exact", "fast"):
            found = vars(hard_cases.measure(name, preset))
            row |= {f"{preset}_{key}": error for key, error in found.items()}
        rows.append(row)
    return rows
