"""Liftings, which compute the semantic feature of every Gaussian, and their registry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import load_component

if TYPE_CHECKING:  # listing the liftings must not import torch
    from slgaussian.gaussians import Gaussians
    from slgaussian.labels import LabelMaps
    from slgaussian.language.bank import MemoryBank


class Lifting(Protocol):
    """Computes one feature per Gaussian from label maps and codes (f_i, section 3.1)."""

    def __call__(self, gaussians: Gaussians, label_maps: LabelMaps, bank: MemoryBank) -> Gaussians:
        """Return the Gaussians with ``features`` [N, D + 1]: code times weight, and the weight.

        The weight is the fraction of the Gaussian that belongs to a labelled object. A rendered
        feature divided by its last channel is therefore a mixture of codes only: unlabelled
        Gaussians and empty space do not pull it towards the code (0, 0, 0).

        With a bank without codes (D = 0) features are [N, 1]: the object's row in the bank,
        counted from 1, or 0 for no object. Such features are not blended but counted as votes.
        """


def load_lifting(name: str = "hard", **settings: Any) -> Lifting:
    """Make the lifting called ``name``; raises InputError if there is none."""
    return load_component("lifting", name, settings)
