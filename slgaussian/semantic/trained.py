"""The lifting ``branch``: a network that was trained to say what labels lack (section 3.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import PrivateAttr

from slgaussian.errors import InputError
from slgaussian.semantic.branch import Branch, BranchLifting, find_weights, load_branch
from slgaussian.semantic.configs import BranchConfig

if TYPE_CHECKING:
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank


class TrainedBranch(BranchConfig):
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

    _branch: Branch = PrivateAttr()

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.weights is None:
            raise InputError(
                "lifting 'branch': no weights are given; train some with `slgaussian train` and "
                "give the file, as --set branch.weights=trained/branch.safetensors, or choose the "
                "lifting 'hard'"
            )
        self._branch = load_branch(find_weights(self.weights))

    @property
    def branch(self) -> Branch:
        """The network."""
        return self._branch

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """See :class:`slgaussian.semantic.Lifting`; InputError for codes not of three numbers."""
        return BranchLifting(self.branch)(gaussians, label_maps, bank)
