"""Configs of the liftings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from slgaussian.components.config import ComponentConfig, File
from slgaussian.io import file_digest


def weights_digest(place: str | Path) -> str:
    """Compute the SHA-256 of the weights file at ``place``; raises as :func:`find_weights`."""
    from slgaussian.semantic.versions import find_weights

    return file_digest(find_weights(place))


class BranchConfig(ComponentConfig, title="branch"):
    """The lifting by a trained network; no weights are shipped with the package."""

    target = "slgaussian.semantic.branch:load_branch_lifting"

    weights: Annotated[Path | None, File(weights_digest)] = Field(
        None,
        description="Weights of the branch: file that `train` wrote, or folder of versions that "
        "`retrain` keeps.",
    )
