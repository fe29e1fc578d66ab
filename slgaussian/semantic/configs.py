"""Configs of the liftings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from slgaussian.components.config import ComponentConfig, File
from slgaussian.io import file_digest


def weights_digest(place: str | Path) -> str:
    """Compute the SHA-256 of the file of weights that is meant by a place; raises as its search."""
    from slgaussian.semantic.versions import find_weights

    return file_digest(find_weights(place))


class BranchConfig(ComponentConfig, title="branch"):
    """The lifting by the network of a file of weights; the package has none."""

    target = "slgaussian.semantic.branch:load_branch_lifting"

    weights: Annotated[Path | None, File(weights_digest)] = Field(
        None,
        description="Weights of the branch: file that `train` wrote, or folder of versions that "
        "`retrain` keeps.",
    )
