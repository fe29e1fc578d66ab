"""Training the semantic branch: rendered features against the labels of target views.

The base Gaussians are frozen and the loss is a mean squared error on the splatted features (paper,
Implementation Details). Codes are drawn anew whenever a lesson is seen, so that none is learnt by
heart: the paper does not say. The network ``several`` departs further. Its error is taken where a
target pixel has an object that the context labels name, since nothing else can be answered; and the
target of a pixel is the code times the light that the Gaussians give it, since what they leave
empty is not the branch's to fill.

Unless asked otherwise, in most of the steps the context labels are corrupted as masks often are
(:mod:`slgaussian.semantic.corruption`), and the targets stay clean. Without that, on labels that
agree, there is little to learn beyond copying them.

Everything is float32: in bfloat16 the network takes half the time on a processor that multiplies
such matrices, which is a tenth of a step, and longer than now on others.

Everything random depends on (seed, sample, epoch), and the order of lessons on (seed, epoch): where
a training stands is its number of steps. PyTorch computes on a given number of threads here, one
unless said. Its sums of weight gradients depend on how many share the work; the splat's do not. So
the bytes depend on neither the machine's cores nor interruptions, on one kind of processor.

On another device than the processor the network is there, and the splat is not. None has been
tried.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from slgaussian.errors import InputError
from slgaussian.kernels.seeding import seed_for
from slgaussian.kernels.threads import fixed
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.rasterize.planned import plan
from slgaussian.semantic.batch_sampler import Draw, draw_batch
from slgaussian.semantic.branch import (
    DIMENSION,
    Architecture,
    Branch,
    features_of,
    input_images,
    make_branch,
    save_branch,
)
from slgaussian.semantic.checkpoints import load_checkpoint, save_checkpoint, table_of
from slgaussian.semantic.hard import code_images
from slgaussian.semantic.lesson import Lesson

WARM_UP = 0.05
"""Fraction of the steps in which the learning rate rises; it then falls to zero as a cosine."""


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training, besides its lessons.

    Attributes
    ----------
    architecture : Architecture
    steps : int
    batch : int
        Lessons of a step, whose gradients are averaged.
    seed : int
    rate : float
        Highest learning rate, of AdamW.
    decay : float
        Its weight decay.
    clip : float
        Longest gradient; longer ones are shortened to it.
    targets : int
        Target views a step, chosen at random where a lesson has more.
    corrupted : float
        Fraction of the steps in which context labels are corrupted.
    codes : str
        Code strategy by name, as fields will have.
    every : int
        Steps between checkpoints.
    device : str
        Of the network, as PyTorch calls it.
    threads : int
        That PyTorch computes on; on it depend the last bits.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    architecture: Architecture = field(default_factory=Architecture)
    steps: int = 1500
    batch: int = 1
    seed: int = 0
    rate: float = 3e-3
    decay: float = 1e-4
    clip: float = 1.0
    targets: int = 2
    corrupted: float = 0.75
    codes: str = "separated"
    every: int = 100
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        bounds = {
            **dict.fromkeys(("steps", "batch", "targets", "every", "threads"), (1, math.inf)),
            **dict.fromkeys(("rate", "clip"), (1e-300, math.inf)),
            "decay": (0, math.inf),
            "corrupted": (0, 1),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high or value == math.inf:
                raise InputError(
                    f"training {name}: found {value}, expected a number from {low} to {high}"
                )


@dataclass(frozen=True)
class Progress:
    """Progress of a training: ``rate`` in steps a second since it was begun or resumed."""

    step: int
    steps: int
    loss: float
    rate: float

    @property
    def seconds_left(self) -> float:
        """Until the last step, at this rate."""
        return (self.steps - self.step) / self.rate


@dataclass(frozen=True, eq=False)
class Trained:
    """Result of a training: the branch, and its course as a table of spec ``metrics``."""

    branch: Branch
    metrics: pa.Table


def train(
    lessons: Sequence[Lesson],
    settings: TrainingSettings,
    folder: Path,
    start: Branch | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Trained:
    """Train a branch, or go on where a training in ``folder`` was interrupted.

    Parameters
    ----------
    lessons : sequence of Lesson
        Asked for one at a time, so that it may read them from disk. Which lessons they are is the
        caller's to keep: of a resumed training only their number is compared.
    settings : TrainingSettings
    folder : Path
        For ``checkpoint.safetensors`` and ``metrics.parquet``; made if it is not there.
    start : Branch, optional
        Trained weights to begin from, otherwise seeded ones.
    progress : callable, optional
        Told of every step.

    Raises
    ------
    InputError
        If there is no such device, there are no lessons, a loss is not finite (the message names
        the sample), ``start`` is of another architecture, the folder holds another training, or
        cannot be written.
    """
    if len(lessons) == 0:
        raise InputError("training: found no lessons, expected at least one")
    device = found_device(settings.device)
    architecture = settings.architecture
    branch = make_branch(architecture, seed_for(settings.seed, "", "branch") % 2**63)
    if start is not None:
        if start.architecture != settings.architecture:
            raise InputError(
                f"training: the weights to begin from are of {start.architecture}, expected "
                f"{settings.architecture}; choose that architecture, or begin without"
            )
        branch.load_state_dict(start.state_dict())
    run = asdict(settings) | {
        # As it comes back from JSON.
        "architecture": {**asdict(architecture), "widths": list(architecture.widths)},
        "lessons": len(lessons),
        "start": hashlib.sha256(save_branch(branch)).hexdigest(),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"training folder {folder}: cannot be made ({error.strerror}); choose another"
        ) from error
    branch.to(device)
    # The foreach and fused ones do the same sums; this is 1 ms.
    optimiser = torch.optim.AdamW(
        branch.parameters(), lr=settings.rate, weight_decay=settings.decay, foreach=False
    )
    place = load_checkpoint(folder, branch, optimiser, run)
    rows, begun = place.rows, time.perf_counter()
    with fixed(settings.threads):
        for step in range(place.step, settings.steps):
            drawn = draw_batch(lessons, settings, step)
            rows.append(_step(branch.train(), optimiser, drawn, settings, step))
            if (step + 1) % settings.every == 0 or step + 1 == settings.steps:
                save_checkpoint(folder, branch, optimiser, run, rows)
            if progress is not None:
                rate = (step + 1 - place.step) / (time.perf_counter() - begun)
                progress(Progress(step + 1, settings.steps, rows[-1]["loss"], rate))
    return Trained(branch.cpu().eval(), table_of(rows))


def found_device(name: str) -> torch.device:
    """The device of that name; InputError if PyTorch has none here."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except Exception as error:  # each kind of device has its own
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise InputError(
            f"training device: found {name!r}, which PyTorch does not find here ({reason}); "
            "expected cpu, or another that this installation of PyTorch knows, as cuda"
        ) from None
    return device


def loss_of(
    branch: Branch,
    lesson: Lesson,
    labels: np.ndarray,
    views: Sequence[int],
    codes: str,
    rng: Any,
) -> torch.Tensor:
    """Compute the mean squared error of some of the target views of a lesson.

    Of the network ``paper`` it is the printed one, of all pixels: rendered codes against the codes
    of the targets, (0, 0, 0) where they have no object. Of ``several`` see the module.

    Parameters
    ----------
    branch : Branch
    lesson : Lesson
    labels : int32 [V, H, W]
        What the branch is shown of the context views, the lesson's own labels or worse.
    views : sequence of int
        Which of the targets.
    codes : str
        Code strategy by name.
    rng : numpy Generator
        Decides the codes.

    Returns
    -------
    scalar tensor
        Zero, without gradient, if there is nothing to learn from: no object, or for ``several``
        none that ``labels`` name.
    """
    paper = branch.architecture.name == "paper"
    views_with_codes = np.concatenate([labels, lesson.targets]) if paper else labels
    maps = LabelMaps(views_with_codes, np.ones(views_with_codes.shape, np.float32))
    if len(maps.ids) == 0:
        return torch.zeros(())
    drawn = load_codes(codes)(maps, rng)
    matches = lesson.matches if branch.architecture.others else None
    images = input_images(labels, maps.ids, drawn, matches)
    features = features_of(branch, images, lesson.gaussians.source)
    total, counted = torch.zeros(()), 0
    for view in views:
        wanted = torch.from_numpy(code_images(lesson.targets[view], maps.ids, drawn))
        planned = plan(lesson.gaussians, lesson.cameras[view])
        rendered = planned.render(features)
        if paper:
            error = (rendered - wanted)[..., :DIMENSION]
            weight = torch.ones_like(wanted[..., -1:])
        else:
            error = rendered - planned.alpha[..., None] * wanted
            weight = wanted[..., -1:]
        total = total + (weight * error.square()).sum()
        counted += int(weight.sum()) * error.shape[-1]
    return total / counted if counted else torch.zeros(())


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
        arguments = draw.lesson, draw.labels, draw.views, settings.codes, draw.rng
        loss = loss_of(branch, *arguments) / len(drawn)
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
    return {
        "step": step + 1,
        "epoch": drawn[0].epoch,
        "sample": names,
        "corrupted": any(draw.corrupted for draw in drawn),
        "loss": value,
        "norm": length,
        "rate": rate,
    }


def _schedule(done: float) -> float:
    """Fraction of the highest learning rate when a fraction ``done`` of the steps is."""
    if done < WARM_UP:
        return done / WARM_UP
    return 0.5 * (1 + math.cos(math.pi * (done - WARM_UP) / (1 - WARM_UP)))
