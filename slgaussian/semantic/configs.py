"""Configs of the liftings and of their training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from slgaussian.components.config import ComponentConfig, Config, File
from slgaussian.io import file_digest

LIFTINGS = {
    "hard": "slgaussian.semantic.configs:HardConfig",
    "filled": "slgaussian.semantic.configs:FilledConfig",
    "branch": "slgaussian.semantic.configs:BranchConfig",
}


def weights_digest(place: str | Path) -> str:
    """Compute the SHA-256 of the weights file at ``place``; raises as :func:`find_weights`."""
    from slgaussian.semantic.versions import find_weights

    return file_digest(find_weights(place))


class HardConfig(ComponentConfig, title="hard"):
    """Copy the label of the source pixel (SegSplat, arXiv 2511.18386, lifts the same way)."""

    target = "slgaussian.semantic.hard:HardIndex"


class FilledConfig(ComponentConfig, title="filled"):
    """Fill unlabelled pixels from other views, then copy the label of the source pixel."""

    target = "slgaussian.semantic.hard:Filled"


class BranchConfig(ComponentConfig, title="branch"):
    """The lifting by a trained network; no weights are shipped with the package."""

    target = "slgaussian.semantic.branch:load_branch_lifting"

    weights: Annotated[Path | None, File(weights_digest)] = Field(
        None,
        description="Weights of the branch: file that `train` wrote, or folder of versions that "
        "`retrain` keeps.",
    )


class TrainingConfig(Config):
    """Hyperparameters of a training that users choose."""

    steps: int = Field(1500, ge=1, description="Number of training steps.")
    batch: int = Field(1, ge=1, description="Number of lessons per step.")
    rate: float = Field(3e-3, gt=0, description="Largest learning rate.")
    device: str = Field(
        "cpu", description="PyTorch device of the network; only cpu and cuda are tested."
    )
    threads: int = Field(
        1, ge=1, description="Threads of PyTorch; the last bits of results depend on the number."
    )
