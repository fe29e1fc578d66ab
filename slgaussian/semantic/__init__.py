"""Give every Gaussian its semantic feature: the liftings and how to get one by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import load_component

if TYPE_CHECKING:  # the names of the liftings are asked for where nobody waits for torch
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank

LIFTINGS = {
    "hard": "slgaussian.semantic.hard:HardIndex",
    "filled": "slgaussian.semantic.hard:Filled",
    "branch": "slgaussian.semantic.configs:BranchConfig",
}


class Lifting(Protocol):
    """Turns label maps and codes into a feature a Gaussian (the paper's f_i, section 3.1)."""

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """The same Gaussians with ``features`` [N, D + 1]: code times weight, and the weight.

        The weight is the fraction of the Gaussian that belongs to a known object, so that a
        rendered feature divided by its last channel is a mixture of codes only: what is unlabelled,
        and what is empty, does not pull it towards the code (0, 0, 0).

        In a bank without codes (D = 0) it is [N, 1]: the number of the object's row in the bank,
        from 1, and 0 for no object. Such features are not mixed: they are votes.
        """


def load_lifting(name: str = "hard", **settings: Any) -> Lifting:
    """Make the lifting called ``name``; raises InputError if there is none."""
    return load_component("lifting", name, settings)
