"""The lifting ``branch``: a network that was trained to say what labels lack (section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from slgaussian.errors import InputError
from slgaussian.parts.identity import file_digest
from slgaussian.parts.settings import setting

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank
    from slgaussian.semantic.branch import Branch


def weights_digest(place: str | Path) -> str:
    """What weights are known by: SHA-256 of their file; raises as what finds it."""
    from slgaussian.semantic.branch import find_weights

    return file_digest(find_weights(place))


@dataclass(frozen=True, eq=False)
class TrainedBranch:
    """The lifting by the network of a file of weights; the package has none.

    Attributes
    ----------
    weights : str or path
        What :func:`slgaussian.semantic.branch.find_weights` takes. Has no default.

    Raises
    ------
    InputError
        If none are given, there are none, or they are damaged.
    """

    weights: str | Path | None = setting(
        None,
        "Weights of the branch: file that `train` wrote, or folder of versions that `retrain` "
        "keeps.",
        content=weights_digest,
    )
    branch: Branch = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.weights is None:
            raise InputError(
                "lifting 'branch': no weights are given; train some with `slgaussian train` and "
                "give the file, as --set branch.weights=trained/branch.safetensors, or choose the "
                "lifting 'hard'"
            )
        from slgaussian.semantic.branch import find_weights, load_branch

        object.__setattr__(self, "branch", load_branch(find_weights(self.weights)))

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; InputError for codes not of three numbers."""
        from slgaussian.semantic.branch import BranchLifting

        return BranchLifting(self.branch)(gaussians, label_maps, bank)
