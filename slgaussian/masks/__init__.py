"""From photographs to label maps: proposers, trackers, association and the replication vote."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import load_component
from slgaussian.io import short_repr

if TYPE_CHECKING:  # the names of the parts are asked for where nobody waits for torch
    import numpy as np

    from slgaussian.geometry import SeenView

PROPOSERS = {
    "regions": "slgaussian.masks.regions:Regions",
    "sam": "slgaussian.masks.configs:SamConfig",
    "sam2": "slgaussian.masks.configs:Sam2Config",
}
TRACKERS = {
    "geometric": "slgaussian.masks.geometric:GeometricTracker",
    "sam2-video": "slgaussian.masks.configs:Sam2VideoConfig",
    "precomputed": "slgaussian.masks.configs:PrecomputedConfig",
}


@dataclass(frozen=True, eq=False)
class Proposals:
    """Candidate object masks of one image, possibly overlapping.

    Attributes
    ----------
    masks : bool [M, H, W]
    scores : float32 [M]
        Higher is better; comparable within one image only.
    levels : uint8 [M], optional
        0, 1 or 2 for a part, an object or a group of them (s, m, l), from proposers that know.
    """

    masks: np.ndarray
    scores: np.ndarray
    levels: np.ndarray | None = None

    __repr__ = short_repr


class MaskProposer(Protocol):
    """Finds objects in one image."""

    def propose(self, seen: SeenView, where: np.ndarray | None = None) -> Proposals:
        """Propose masks for a photograph, ``seen.image`` uint8 [H, W, 3].

        ``seen.depth`` (float32 [H, W], scene units, 0 unknown) is its *predicted* depth, used where
        it helps. ``where`` (bool [H, W]) limits the search to pixels that no object covers yet.
        """


class MaskTracker(Protocol):
    """Carries labels from remembered frames to a new one.

    The predicted depth of a view is in the frame of its camera; a tracker may need it.

    Attributes
    ----------
    final : bool
        Whether it brings the labels of whole views by itself: nothing is proposed, merged or voted
        on then, and its ids stay as they are.
    repeatable : bool
        Whether it answers a view again as before while nothing more is remembered; not, if it does
        not say.
    """

    final: bool
    repeatable: bool

    def add(self, seen: SeenView, labels: np.ndarray) -> None:
        """Remember a frame and its labels, int32 [H, W], 0 = unassigned."""

    def propagate(self, seen: SeenView) -> np.ndarray:
        """Labels int32 [H, W] for a view from what is remembered; 0 where nothing matches."""


def load_proposer(name: str = "regions", **settings: Any) -> MaskProposer:
    """Make the mask proposer called ``name``; raises InputError if there is none."""
    return load_component("proposer", name, settings)


def load_tracker(name: str = "geometric", **settings: Any) -> MaskTracker:
    """Make a fresh, empty tracker called ``name``; raises InputError if there is none."""
    return load_component("tracker", name, settings)
