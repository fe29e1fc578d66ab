"""Training of the semantic branch: rendered features against the labels of target views.

The base Gaussians are frozen and the loss is a mean squared error on the splatted features (paper,
Implementation Details). Codes are drawn anew whenever a lesson is used, so the network cannot
memorise codes; the paper does not state this.

All random draws are seeded by (seed, sample, epoch), and the order of lessons by (seed, epoch): the
step number alone determines the state of all random generators. PyTorch runs on a fixed number of
threads, by default one, because its sums of weight gradients depend on the number of threads; those
of the rasteriser do not. Results are therefore the same bytes on one kind of CPU, whatever the
number of cores and interruptions.

On a GPU only the network is moved; rasterisation stays on the CPU. Losses are those of a CPU within
1e-7, and a step at 240 x 320 takes 0.4 of the time (H100 beside 16 cores).
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import torch
from pydantic import Field
from torch.nn import functional as F

from slgaussian.errors import InputError
from slgaussian.kernels.seeding import rng_for, seed_for
from slgaussian.kernels.threads import limit_threads
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.rasterize import rasterize
from slgaussian.semantic.branch import (
    DIMENSION,
    Architecture,
    Branch,
    compute_features,
    input_images,
    make_branch,
    save_branch,
)
from slgaussian.semantic.checkpoints import load_checkpoint, save_checkpoint, tabulate_metrics
from slgaussian.semantic.configs import TrainingConfig
from slgaussian.semantic.lesson import Lesson

WARM_UP = 0.05
"""Fraction of the steps with a rising learning rate, before its cosine decay to zero."""


class TrainingSettings(TrainingConfig, title="training"):
    """Hyperparameters of a training."""

    architecture: Architecture = Architecture()
    seed: int = 0
    decay: float = Field(1e-4, ge=0, description="Weight decay of AdamW.")
    clip: float = Field(1.0, gt=0, description="Largest gradient norm; larger ones are scaled.")
    targets: int = Field(
        2, ge=1, description="Target views per step, drawn at random if a lesson has more."
    )
    codes: str = Field(
        "separated",
        description="Code strategy; should be that of the fields that will use the branch.",
    )
    every: int = Field(100, ge=1, description="Steps between checkpoints.")


@dataclass(frozen=True)
class Progress:
    """Progress of a training; ``rate`` is in steps per second since its start or resume."""

    step: int
    steps: int
    loss: float
    rate: float

    @property
    def remaining_seconds(self) -> float:
        """Estimated seconds until the last step."""
        return (self.steps - self.step) / self.rate


@dataclass(frozen=True, eq=False)
class Trained:
    """Result of a training: the branch, and the metrics of all steps (spec ``metrics``)."""

    branch: Branch
    metrics: pa.Table


class Draw(NamedTuple):
    """One lesson of a batch.

    Attributes:
        views: Indices of the target views.
        epoch: Number of completed passes over all lessons.
        rng: Draws the codes.
    """

    lesson: Lesson
    views: list[int]
    epoch: int
    rng: np.random.Generator


def draw_batch(lessons: Sequence[Lesson], settings: TrainingSettings, step: int) -> list[Draw]:
    """Draw the lessons of ``step`` (counted from 0), without replacement within an epoch."""
    batch = []
    for number in range(step * settings.batch, (step + 1) * settings.batch):
        epoch, place = divmod(number, len(lessons))
        order = rng_for(settings.seed, "", f"order {epoch}").permutation(len(lessons))
        lesson = lessons[int(order[place])]
        rng = rng_for(settings.seed, lesson.content, f"step {epoch}")
        views = sorted(rng.permutation(len(lesson.cameras))[: settings.targets].tolist())
        batch.append(Draw(lesson, views, epoch, rng))
    return batch


def train(
    lessons: Sequence[Lesson],
    settings: TrainingSettings,
    folder: Path,
    start: Branch | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Trained:
    """Train a branch, or resume an interrupted training in ``folder``.

    Args:
        lessons: Indexed one at a time, so it may read them from disk. A resumed training needs the
            same lessons: only their number is checked.
        folder: For ``checkpoint.pt``; created if missing.
        start: Initial weights; by default random ones from the seed.
        progress: Called after every step.

    Raises:
        InputError: If the device does not exist, there are no lessons, a loss is not finite (the
            message names the sample), ``start`` has another architecture, or the folder holds
            another training or cannot be written.
    """
    if len(lessons) == 0:
        raise InputError("training: found no lessons, expected at least one")
    device, architecture = find_device(settings.device), settings.architecture
    branch = make_branch(architecture, seed_for(settings.seed, "", "branch") % 2**63)
    if start is not None:
        if start.architecture != architecture:
            raise InputError(
                f"training: the weights to begin from are of {start.architecture}, expected "
                f"{architecture}; choose that architecture, or begin without"
            )
        branch.load_state_dict(start.state_dict())
    start_digest = hashlib.sha256(save_branch(branch)).hexdigest()
    metadata = {
        "architecture": asdict(architecture),
        "lessons": len(lessons),
        "start": start_digest,
    }
    run = dict(settings) | metadata
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"training folder {folder}: cannot be made ({error.strerror}); choose another"
        ) from error
    branch.to(device)
    # The foreach and fused variants compute the same; this one takes 1 ms.
    optimiser = torch.optim.AdamW(
        branch.parameters(), lr=settings.rate, weight_decay=settings.decay, foreach=False
    )
    rows = load_checkpoint(folder, branch, optimiser, run)
    resumed, start_time = len(rows), time.perf_counter()
    with limit_threads(settings.threads):
        for step in range(resumed, settings.steps):
            drawn = draw_batch(lessons, settings, step)
            rows.append(_step(branch.train(), optimiser, drawn, settings, step))
            if (step + 1) % settings.every == 0 or step + 1 == settings.steps:
                save_checkpoint(folder, branch, optimiser, run, rows)
            if progress is not None:
                rate = (step + 1 - resumed) / (time.perf_counter() - start_time)
                progress(Progress(step + 1, settings.steps, rows[-1]["loss"], rate))
    return Trained(branch.cpu().eval(), tabulate_metrics(rows))


def find_device(name: str) -> torch.device:
    """Return the PyTorch device called ``name``; InputError if it is not available."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except Exception as error:  # the type depends on the kind of device
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise InputError(
            f"training device: found {name!r}, which PyTorch cannot use here ({reason}); "
            "expected cpu, or another device that this installation of PyTorch supports, as cuda"
        ) from None
    return device


def compute_loss(
    branch: Branch, lesson: Lesson, views: Sequence[int], codes: str, rng: np.random.Generator
) -> torch.Tensor:
    """Compute the mean squared error over all pixels of the chosen target views of a lesson.

    Rendered codes are compared with those of the targets, (0, 0, 0) where they have no object.
    Transparent pixels have no error.

    Args:
        views: Indices of the target views.
        codes: Name of the code strategy.
        rng: Draws the codes.

    Returns:
        Zero, without gradient, if there is no object; NaN if a feature is not finite.
    """
    labels = np.concatenate([lesson.labels, lesson.targets])
    maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    if len(maps.ids) == 0:
        return torch.zeros(())
    drawn = load_codes(codes)(maps, rng)
    images = input_images(lesson.labels, maps.ids, drawn)
    features = compute_features(branch, images, lesson.gaussians.source)[:, :DIMENSION]
    if not features.isfinite().all():
        return torch.tensor(torch.nan)
    targets = input_images(lesson.targets[list(views)], maps.ids, drawn)
    cameras = [lesson.cameras[view] for view in views]
    rendered = [rasterize(lesson.gaussians, features, camera).values for camera in cameras]
    drawn_views = torch.stack(rendered)
    if lesson.opaque is not None:  # the codes of transparent pixels are 0
        drawn_views = drawn_views * torch.from_numpy(lesson.opaque[list(views), ..., None])
    return F.mse_loss(drawn_views, targets)


def _step(
    branch: Branch,
    optimiser: torch.optim.Optimizer,
    drawn: Sequence[Draw],
    settings: TrainingSettings,
    step: int,
) -> dict[str, Any]:
    optimiser.zero_grad()
    losses = []
    for draw in drawn:
        loss = compute_loss(branch, draw.lesson, draw.views, settings.codes, draw.rng) / len(drawn)
        if loss.requires_grad:
            loss.backward()
        losses.append(float(loss.detach()))
    norm = torch.nn.utils.clip_grad_norm_(branch.parameters(), settings.clip)
    value, length = sum(losses), float(norm)
    names = ", ".join(draw.lesson.sample for draw in drawn)
    if not math.isfinite(value + length):
        raise InputError(
            f"training step {step + 1}: sample {names!r} gives a loss of {value:g} with a "
            f"gradient of length {length:g}; leave it out or lower the rate, and run again: it "
            "goes on from the last checkpoint"
        )
    rate = settings.rate * _schedule((step + 1) / settings.steps)
    for group in optimiser.param_groups:
        group["lr"] = rate
    optimiser.step()
    row = {"step": step + 1, "epoch": drawn[0].epoch, "sample": names}
    return row | {"loss": value, "norm": length, "rate": rate}


def _schedule(done: float) -> float:
    """Return the learning rate, relative to the highest, after a fraction ``done`` of the steps."""
    if done < WARM_UP:
        return done / WARM_UP
    return 0.5 * (1 + math.cos(math.pi * (done - WARM_UP) / (1 - WARM_UP)))
