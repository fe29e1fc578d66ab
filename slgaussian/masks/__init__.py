"""From photographs to label maps: proposers, trackers, association and the replication vote."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from slgaussian.registry import resolve
from slgaussian.scene import View

PROPOSERS = {"regions": "slgaussian.masks.regions:Regions"}
TRACKERS = {"flow": "slgaussian.masks.flow:FlowTracker"}


@dataclass(frozen=True, eq=False)
class Proposals:
    """Candidate object masks of one image, possibly overlapping.

    Attributes
    ----------
    masks : bool [M, H, W]
    scores : float32 [M]
        Higher is better; comparable within one image only.
    """

    masks: np.ndarray
    scores: np.ndarray


class MaskProposer(Protocol):
    """Finds objects in one image."""

    def propose(
        self, image: np.ndarray, where: np.ndarray | None = None, depth: np.ndarray | None = None
    ) -> Proposals:
        """Propose masks for ``image`` uint8 [H, W, 3].

        ``where`` (bool [H, W]) limits the search to pixels that no object covers yet; ``depth``
        (float32 [H, W], scene units, 0 unknown) is the *predicted* depth, used where it helps.
        """


class MaskTracker(Protocol):
    """Carries labels from remembered frames to a new one."""

    def add(self, view: View, labels: np.ndarray) -> None:
        """Remember a frame and its labels, int32 [H, W], 0 = unassigned."""

    def propagate(self, view: View) -> np.ndarray:
        """Labels int32 [H, W] for ``view`` from what is remembered; 0 where nothing matches."""


def load_proposer(name: str = "regions", **settings: Any) -> MaskProposer:
    """Make the mask proposer called ``name``; raises InputError if there is none."""
    return resolve("mask proposer", PROPOSERS, name)(**settings)


def load_tracker(name: str = "flow", **settings: Any) -> MaskTracker:
    """Make a fresh, empty tracker called ``name``; raises InputError if there is none."""
    return resolve("mask tracker", TRACKERS, name)(**settings)
