"""Statistics of a field, stored with it: numbers of Gaussians, and bytes.

They are deterministic; timings are not among them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class FieldStatistics:
    """Counts and sizes of a field, under ``account`` in the settings of its ``field.json``.

    Attributes:
        gaussians_made, gaussians_kept: Numbers of predicted Gaussians and of those in the field.
        change_mean, change_rms, change_greatest: Difference between renderings of the context views
            before and after merging Gaussians, in grey levels; see
            :class:`slgaussian.rasterize.merging.Change`.
        replicas_asked: Number of copies of each view that vote.
        bytes_gaussians, bytes_bank: Sizes of the arrays of Gaussians and memory bank.
        replicas_computed: Largest number of copies of one view that were segmented or tracked; the
            others are identical. None if unknown.
        depths_tried, depths_possible: Numbers of depth candidates of all views, compared and
            allowed by the settings; None if the predictor does not report them.
    """

    gaussians_made: int
    gaussians_kept: int
    change_mean: float
    change_rms: float
    change_greatest: float
    replicas_asked: int
    bytes_gaussians: int
    bytes_bank: int
    replicas_computed: int | None = None
    depths_tried: int | None = None
    depths_possible: int | None = None

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers, rounded to four decimals."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}

    def lines(self) -> list[str]:
        """Return a readable description, line by line."""
        share = self.gaussians_kept / max(self.gaussians_made, 1)
        lines = [
            f"Gaussians: {self.gaussians_kept:,} of {self.gaussians_made:,} predicted "
            f"({share:.0%}); change of the context views: {self.change_mean:.2f} grey levels mean, "
            f"{self.change_rms:.2f} root mean square, {self.change_greatest:.1f} maximum"
        ]
        if self.depths_tried is not None:
            lines.append(f"depth candidates: {self.depths_tried:,} of {self.depths_possible:,}")
        computed = self.replicas_computed
        return [
            *lines,
            f"replicas: {'' if computed is None else f'{computed} computed of '}"
            f"{self.replicas_asked} requested",
            f"bytes: Gaussians {self.bytes_gaussians:,}, memory bank {self.bytes_bank:,}",
        ]
