"""Consensus of many views on objects: every view votes on which surface points are one object.

One view joins objects that another splits, and an object that is new in a view may already have an
id from a view without overlap. So the label maps are divided into atoms, the pixels of one view
with one label in one detected region, and each view votes on all visible points of the atoms of all
views. The votes on atoms p and q are

    sum over views v of  f_pv . f_qv - MAJORITY c_pv c_qv,

where f_pv are the shares of the points of p in each region that was detected in v, and c_pv is
their sum, the share of p that is visible in v. The first term counts the pairs of points that a
view assigns to one region, the second all visible pairs. The tracker has a vote as well. Greedy
additive edge contraction (Keuper et al., ICCV 2015) joins the pair of atoms with most votes first,
adds up the votes of joined atoms, and stops when no pair has more votes for than against. The
result does not depend on the order of the views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from slgaussian.geometry import SeenView
from slgaussian.masks.flatten import CRUMB_SHARE
from slgaussian.masks.shared import SurfacePoints, match_points, overlap

MAX_VOTERS = 8
"""Largest number of other views that vote on a view, those with the greatest overlap."""
MIN_OVERLAP = 0.02
"""Smallest overlap of a voting view."""
MAJORITY = 0.4
"""Fraction of votes from which points are one object; below a half because proposals split objects
more often than they join them. From 0.3 to 0.5 ids of rooms and photographs are about as stable."""
TRACKER_VOTE = 1.0
"""Vote of the tracker for two atoms with one label; a unanimous view has 0.6."""


@dataclass(frozen=True, eq=False)
class Atoms:
    """The P atoms of label maps.

    Attributes:
        maps: int64 [V, H * W]. Atom of every pixel, 0 .. P-1; -1 where there is no label.
        view, label, region: int64 [P]. View of an atom, its label there, and its detected region,
            numbered over all views.
    """

    maps: np.ndarray
    view: np.ndarray
    label: np.ndarray
    region: np.ndarray

    @staticmethod
    def of(labels: np.ndarray, detected: np.ndarray) -> Atoms:
        """Divide ``labels`` int32 [V, H, W] by the regions ``detected`` int32 [V, H, W].

        A piece below the crumb size joins the largest piece of its label in its view.
        """
        maps, views, owners, regions = [], [], [], []
        columns, start = int(detected.max(initial=0)) + 1, 0
        for view, (label, cut) in enumerate(zip(labels, detected, strict=True)):
            keys = (label.astype(np.int64) * columns + cut).ravel()
            pieces, of_pixel, area = np.unique(keys, return_inverse=True, return_counts=True)
            owner, region = np.divmod(pieces, columns)
            order = np.lexsort((-area, owner))
            largest = order[np.searchsorted(owner[order], owner)]
            goes = np.where(area >= CRUMB_SHARE * label.size, np.arange(len(pieces)), largest)
            numbered = np.unique(goes[owner > 0])
            number = np.full(len(pieces), -1)
            number[numbered] = start + np.arange(len(numbered))
            maps.append(np.where(owner > 0, number[goes], -1)[of_pixel])
            views.append(np.full(len(numbered), view))
            owners.append(owner[numbered])
            regions.append(view * columns + region[numbered])
            start += len(numbered)
        joined = (np.concatenate(parts) for parts in (views, owners, regions))
        return Atoms(np.stack(maps), *joined)

    def __len__(self) -> int:
        return len(self.view)


def vote_on_objects(
    frames: Sequence[SeenView], labels: np.ndarray, detected: np.ndarray
) -> np.ndarray:
    """Join and split the objects of three or more views by the votes of all views.

    Labels of two views do not change, because no third view can decide a disagreement.

    Args:
        frames: sequence of V SeenView. With depth.
        labels: int32 [V, H, W]. Labels from the tracker; 0, unassigned, does not change.
        detected: int32 [V, H, W]. Detected regions of each view, 0 where there is none.

    Returns:
        int32 [V, H, W]: A joined object has the lowest of its ids, the first to appear. Of several
            objects with one id, the largest in the view where the id first appeared keeps it; the
            others take their next id, or a new one above all. Joined ids leave gaps.
    """
    if len(frames) < 3 or not labels.any():
        return labels
    atoms = Atoms.of(labels, detected)
    votes = votes_on(atoms, [SurfacePoints(frame) for frame in frames])
    votes[atoms.label[:, None] == atoms.label] += TRACKER_VOTE
    ids = _names(contract(votes), atoms)
    return np.append(ids, 0)[atoms.maps].reshape(labels.shape).astype(np.int32)


def votes_on(atoms: Atoms, points: Sequence[SurfacePoints]) -> np.ndarray:
    """Compute the votes of all views on each pair of atoms, float32 [P, P]; see the module."""
    all_atoms = np.arange(len(atoms))
    rows, columns, weights = [all_atoms], [atoms.region], [np.ones(len(atoms))]
    for view, voters in enumerate(_voters(points)):
        pixels = points[view].pixels()
        view_atoms = atoms.maps[view][pixels]
        area = np.bincount(view_atoms[view_atoms >= 0], minlength=len(atoms))
        for voter in voters:
            which, place = match_points(points[view], points[voter], pixels)
            atom, voter_atom = view_atoms[which], atoms.maps[voter][place]
            in_both = (atom >= 0) & (voter_atom >= 0)
            rows.append(atom[in_both])
            columns.append(atoms.region[voter_atom[in_both]])
            weights.append(1 / area[atom[in_both]])
    voter_of = np.zeros(atoms.region.max(initial=0) + 1, np.int64)
    voter_of[atoms.region] = atoms.view
    atom, region, weight = map(np.concatenate, (rows, columns, weights))
    # Sparse products do not use BLAS: their last digit does not depend on threads.
    share = sparse.csr_array((weight, (atom, region)), shape=(len(atoms), len(voter_of)))
    sees = sparse.csr_array((weight, (atom, voter_of[region])), shape=(len(atoms), len(points)))
    return (share @ share.T - MAJORITY * (sees @ sees.T)).astype(np.float32).toarray()


def _voters(points: Sequence[SurfacePoints]) -> list[list[int]]:
    """Return the voting views of each view, by falling overlap."""
    voters = []
    for view in points:
        shares = np.array(
            [0.0 if view is candidate else overlap(view, candidate) for candidate in points]
        )
        order = np.argsort(-shares, kind="stable")[:MAX_VOTERS]
        voters.append([int(k) for k in order if shares[k] >= MIN_OVERLAP])
    return voters


def contract(votes: np.ndarray) -> np.ndarray:
    """Join the pair with most votes until no pair has more votes for than against.

    Args:
        votes: float [P, P]. Symmetric; modified in place. The diagonal is ignored.

    Returns:
        int64 [P]: Cluster of each atom, named by its lowest member.
    """
    count = len(votes)
    cluster = np.arange(count)
    np.fill_diagonal(votes, -np.inf)
    best = votes.argmax(1)
    best_votes = votes[cluster, best]
    while best_votes.max(initial=-np.inf) > 0:
        gone = int(best_votes.argmax())
        keep, gone = sorted((gone, int(best[gone])))
        cluster[cluster == gone] = keep
        votes[keep] += votes[gone]
        votes[:, keep] = votes[keep]
        votes[gone] = votes[:, gone] = best_votes[gone] = -np.inf
        votes[keep, keep] = -np.inf
        # Recompute the best only of rows whose best was one of the two; others compare with `keep`.
        stale = np.flatnonzero(((best == keep) | (best == gone)) & (best_votes > -np.inf))
        stale = np.union1d(stale, [keep])
        best[stale] = votes[stale].argmax(1)
        best_votes[stale] = votes[stale, best[stale]]
        better = votes[keep] > best_votes
        best[better], best_votes[better] = keep, votes[keep, better]
    return cluster


def _names(cluster: np.ndarray, atoms: Atoms) -> np.ndarray:
    """Return the id of every atom, int64 [P]; see :func:`vote_on_objects`."""
    area = np.bincount(atoms.maps[atoms.maps >= 0], minlength=len(atoms))
    name = np.zeros(len(atoms), np.int64)
    for label in np.unique(atoms.label):
        free = (atoms.label == label) & (name[cluster] == 0)
        if free.any():
            free &= atoms.view == atoms.view[free].min()
            name[np.bincount(cluster[free], area[free]).argmax()] = label
    nameless = np.unique(cluster)[name[np.unique(cluster)] == 0]
    name[nameless] = int(atoms.label.max()) + 1 + np.arange(len(nameless))
    return name[cluster]
