"""Objects of many views by consensus: every view votes on which points are one object.

Views cut up the same things differently: what one joins, another splits, and what is new in one may
have another id already, from a view that does not overlap it. So the label maps are cut into atoms,
the pixels of one view that have one label and lie in one detected region, and each view votes on
all points of atoms that it sees, in whichever view they were labelled. The votes on atoms p and q
are

    sum over views v of  f_pv . f_qv - MAJORITY c_pv c_qv,

where f_pv are the shares of the points of p in each region that was detected in v, and c_pv their
sum, the share of p that v sees: the first term counts the pairs of points that a view puts into one
region, the second those that it sees at all. The tracker has a vote of its own. The pair of atoms
with most votes is joined first, votes of what is joined are added up, and it ends when no two have
more votes for than against (greedy additive edge contraction, Keuper et al., ICCV 2015). The order
of the views counts for nothing in this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from slgaussian.geometry import SeenView
from slgaussian.masks.flatten import CRUMB_SHARE
from slgaussian.masks.shared import SurfacePoints, met, overlap

VOTERS = 8
"""Other views that vote on what a view shows: those that show most of it."""
LEAST_OVERLAP = 0.02
"""Share of a view that another must show to vote on it."""
MAJORITY = 0.4
"""Points are one object from this share of the votes on: proposals cut things up more often than
they join them. From 0.3 to 0.5 the objects of rooms and photographs keep their ids about as well.
"""
TRACKED = 1.0
"""What the tracker's word that two atoms are one counts, where a view that is sure counts 0.6."""


@dataclass(frozen=True, eq=False)
class Atoms:
    """The pieces that label maps consist of, P of them.

    Attributes
    ----------
    maps : int64 [V, H * W]
        Atom of every pixel, 0 .. P-1; -1 where there is no label.
    view, label, region : int64 [P]
        The view that shows an atom, its label there, and the detected region that it lies in, of
        all views counted on.
    """

    maps: np.ndarray
    view: np.ndarray
    label: np.ndarray
    region: np.ndarray

    @staticmethod
    def of(labels: np.ndarray, detected: np.ndarray) -> Atoms:
        """Cut ``labels`` int32 [V, H, W] where the regions ``detected`` int32 [V, H, W] end.

        A crumb goes with the largest piece of its label in its view.
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
            kept = np.unique(goes[owner > 0])
            number = np.full(len(pieces), -1)
            number[kept] = start + np.arange(len(kept))
            maps.append(np.where(owner > 0, number[goes], -1)[of_pixel])
            views.append(np.full(len(kept), view))
            owners.append(owner[kept])
            regions.append(view * columns + region[kept])
            start += len(kept)
        joined = (np.concatenate(parts) for parts in (views, owners, regions))
        return Atoms(np.stack(maps), *joined)

    def __len__(self) -> int:
        return len(self.view)


def settle(seen: Sequence[SeenView], labels: np.ndarray, detected: np.ndarray) -> np.ndarray:
    """Join and split the objects of three views and more by the votes of all.

    Two views have nobody to settle what they disagree on, so that theirs stay as they are.

    Parameters
    ----------
    seen : sequence of V SeenView
        With depth.
    labels : int32 [V, H, W]
        What the tracker made of them, 0 for none, which stays.
    detected : int32 [V, H, W]
        Regions of each view by itself, 0 where there is none.

    Returns
    -------
    int32 [V, H, W]
        An object keeps the least id of those that it was known by, the one that appeared first; of
        several with one id, the largest where that id appeared keeps it. The others take the next
        of their own, or a new one above all. Ids that are joined to others leave gaps.
    """
    if len(seen) < 3 or not labels.any():
        return labels
    atoms = Atoms.of(labels, detected)
    votes = votes_on(atoms, [SurfacePoints(here) for here in seen])
    votes[atoms.label[:, None] == atoms.label] += TRACKED
    ids = _names(contract(votes), atoms)
    return np.append(ids, 0)[atoms.maps].reshape(labels.shape).astype(np.int32)


def votes_on(atoms: Atoms, points: Sequence[SurfacePoints]) -> np.ndarray:
    """Votes of all views on each two atoms, float32 [P, P]; see the module."""
    everyone = np.arange(len(atoms))
    rows, columns, weights = [everyone], [atoms.region], [np.ones(len(atoms))]
    for view, voters in enumerate(_voters(points)):
        pixels = points[view].pixels
        mine = atoms.maps[view][pixels]
        area = np.bincount(mine[mine >= 0], minlength=len(atoms))
        for voter in voters:
            which, place = met(points[view], points[voter], pixels)
            atom, other = mine[which], atoms.maps[voter][place]
            both = (atom >= 0) & (other >= 0)
            rows.append(atom[both])
            columns.append(atoms.region[other[both]])
            weights.append(1 / area[atom[both]])
    voter_of = np.zeros(atoms.region.max(initial=0) + 1, np.int64)
    voter_of[atoms.region] = atoms.view
    atom, region, weight = map(np.concatenate, (rows, columns, weights))
    # Sparse products are no BLAS: their last digit does not depend on threads.
    share = sparse.csr_array((weight, (atom, region)), shape=(len(atoms), len(voter_of)))
    sees = sparse.csr_array((weight, (atom, voter_of[region])), shape=(len(atoms), len(points)))
    return (share @ share.T - MAJORITY * (sees @ sees.T)).astype(np.float32).toarray()


def _voters(points: Sequence[SurfacePoints]) -> list[list[int]]:
    """For each view the others that vote on it, those that show most of it first."""
    found = []
    for one in points:
        shares = np.array([0.0 if one is other else overlap(one, other) for other in points])
        order = np.argsort(-shares, kind="stable")[:VOTERS]
        found.append([int(k) for k in order if shares[k] >= LEAST_OVERLAP])
    return found


def contract(votes: np.ndarray) -> np.ndarray:
    """Join what has most votes, until nothing has more for than against.

    Parameters
    ----------
    votes : float [P, P]
        Symmetric; is used up. The diagonal means nothing.

    Returns
    -------
    int64 [P]
        The cluster of each, named by its least member.
    """
    count = len(votes)
    cluster = np.arange(count)
    np.fill_diagonal(votes, -np.inf)
    best = votes.argmax(1)
    most = votes[cluster, best]
    while most.max(initial=-np.inf) > 0:
        gone = int(most.argmax())
        keep, gone = sorted((gone, int(best[gone])))
        cluster[cluster == gone] = keep
        votes[keep] += votes[gone]
        votes[:, keep] = votes[keep]
        votes[gone] = votes[:, gone] = most[gone] = -np.inf
        votes[keep, keep] = -np.inf
        # Only who had one of the two as the best must look again; to the others `keep` is new.
        again = np.flatnonzero(((best == keep) | (best == gone)) & (most > -np.inf))
        again = np.union1d(again, [keep])
        best[again] = votes[again].argmax(1)
        most[again] = votes[again, best[again]]
        better = votes[keep] > most
        best[better], most[better] = keep, votes[keep, better]
    return cluster


def _names(cluster: np.ndarray, atoms: Atoms) -> np.ndarray:
    """The id of every atom, int64 [P]; see :func:`settle`."""
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
