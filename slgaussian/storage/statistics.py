"""Statistics of a field: its Gaussians, codes and bytes, as the field says it of itself.

The same of the same input: how many seconds a field took is no part of it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class FieldStatistics:
    """Counts and sizes of a field, under ``account`` in the settings of its ``field.json``.

    Attributes
    ----------
    gaussians_made, gaussians_kept : int
        How many were predicted, and how many the field has.
    change_mean, change_rms, change_greatest : float
        What keeping fewer changed in the context views, measured by drawing them before and after,
        in grey levels; see :class:`slgaussian.rasterize.merging.Change`.
    code_dimensions : int
        Numbers of an ID code; 0 without codes.
    replicas_asked : int
    bytes_gaussians, bytes_bank : int
        Of the arrays of Gaussians and memory bank.
    replicas_computed : int or None
        Copies of one view, at most, that were segmented or asked of the tracker; the others are
        known to be the same. None where that was not told.
    depths_tried, depths_possible : int or None
        Depth candidates of all views, and how many the settings allow; None where the predictor
        does not tell.
    """

    gaussians_made: int
    gaussians_kept: int
    change_mean: float
    change_rms: float
    change_greatest: float
    code_dimensions: int
    replicas_asked: int
    bytes_gaussians: int
    bytes_bank: int
    replicas_computed: int | None = None
    depths_tried: int | None = None
    depths_possible: int | None = None

    def as_json(self) -> dict[str, Any]:
        """Plain numbers, four decimals."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}

    def lines(self) -> list[str]:
        """Describe them for people, a line each."""
        share = self.gaussians_kept / max(self.gaussians_made, 1)
        lines = [
            f"Gaussians: {self.gaussians_kept:,} of {self.gaussians_made:,} made ({share:.0%}); "
            f"that changes the context views by {self.change_mean:.2f} grey levels in the mean, "
            f"{self.change_rms:.2f} in the root mean square, {self.change_greatest:.1f} at most"
        ]
        if self.depths_tried is not None:
            lines.append(f"depth candidates: {self.depths_tried:,} of {self.depths_possible:,}")
        computed = self.replicas_computed
        return [
            *lines,
            f"ID codes: {self.code_dimensions} numbers each",
            f"replicas: {'' if computed is None else f'{computed} computed of '}"
            f"{self.replicas_asked} asked for",
            f"bytes: Gaussians {self.bytes_gaussians:,}, memory bank {self.bytes_bank:,}",
        ]
