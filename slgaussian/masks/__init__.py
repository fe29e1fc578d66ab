"""Label maps from photographs: mask proposers, trackers, association and the replication vote."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from slgaussian.components.registry import load_component
from slgaussian.io import short_repr

if TYPE_CHECKING:  # names of components are read where torch is not imported
    import numpy as np

    from slgaussian.geometry import SeenView


@dataclass(frozen=True, eq=False)
class Proposals:
    """Candidate object masks of one image, possibly overlapping.

    Attributes:
        masks: bool [M, H, W]
        scores: float32 [M]. Higher is better; comparable within one image only.
    """

    masks: np.ndarray
    scores: np.ndarray

    __repr__ = short_repr


class MaskProposer(Protocol):
    """Proposes object masks of one image."""

    def propose(self, frame: SeenView, region: np.ndarray | None = None) -> Proposals:
        """Propose masks for a photograph.

        Args:
            frame: ``image`` uint8 [H, W, 3], and ``depth`` float32 [H, W], the *predicted* depth in
                scene units, 0 where unknown, or None.
            region: bool [H, W], optional. Pixels that no object covers yet, to which the search is
                limited.
        """


class MaskTracker(Protocol):
    """Propagates labels from remembered frames to a new one.

    A tracker may require predicted depth. Its memory is of one scene: load another for the next.

    Attributes:
        final: If true, the tracker provides complete label maps: proposals, merging and voting are
            skipped, and its ids do not change.
        repeatable: If true, the tracker returns the same labels for a view until another frame is
            remembered; false by default.
    """

    final: bool
    repeatable: bool

    def add(self, frame: SeenView, labels: np.ndarray) -> None:
        """Remember a frame and its labels, int32 [H, W], 0 = unassigned."""

    def propagate(self, frame: SeenView) -> np.ndarray:
        """Return the propagated labels of a view, int32 [H, W]; 0 where nothing matches."""


def load_proposer(name: str = "regions", **settings: Any) -> MaskProposer:
    """Load the mask proposer ``name``; raises InputError if there is none."""
    return load_component("proposer", name, settings)


def load_tracker(name: str = "geometric", **settings: Any) -> MaskTracker:
    """Load a fresh, empty tracker ``name``; raises InputError if there is none."""
    return load_component("tracker", name, settings)
