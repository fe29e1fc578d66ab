"""What the command that weighs settings is asked, and what it says."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.settings import SceneSettings, read_values
from flows.tradeoff_settings import TradeoffSettings, make_tradeoff_settings
from slgaussian.errors import InputError

if TYPE_CHECKING:
    from flows.tradeoffs import Swept

OTHERS = "views", "against"
"""What a file may say of a run that has nothing to do with settings."""


def asked(
    photos: Sequence[str], cameras: Path | None, values: Mapping[str, Any]
) -> TradeoffSettings:
    """The checked settings: scenes of data and rooms, of a file, or of one's own photographs.

    Raises
    ------
    InputError
        If there is nothing to weigh settings on, or anything given cannot be used.
    """
    given = dict(values)
    if len(photos) == 1 and photos[0].endswith(".toml"):
        file = read_values(Path(photos[0]), given)
        return make_tradeoff_settings(
            {k: v for k, v in file.items() if k not in ("views", "against")}
        )
    settings = make_tradeoff_settings(given)
    if not photos:
        if cameras is not None:
            raise InputError("--cameras: is given without photographs; name them, or leave it out")
        if not any((settings.data, settings.pairs, settings.labels, settings.rooms)):
            raise InputError(
                "tradeoffs: found nothing to weigh settings on; give photographs, --data with "
                "--pairs, or --rooms"
            )
        return settings
    from flows.cli.own_scene import own_scene

    scene, said = own_scene(photos, cameras)
    print(said, file=sys.stderr)
    scenes: list[SceneSettings] = [scene]
    return settings.model_copy(update={"scenes": scenes})


def told(made: Swept) -> str:
    """The settings as a table for a terminal, and what is proposed."""
    from flows.cli.tables import aligned
    from slgaussian.benchmark.tradeoffs import ERRORS

    errors = list(made.weighed[0].errors)
    heads = [f"error {ERRORS[name].partition(':')[0]}" for name in errors]
    rows = [["setting", *heads, "seconds", "MB", "front"]]
    for one in made.weighed:
        front = ["time"] * one.quickest + ["memory"] * one.smallest
        rows.append(
            [
                one.called,
                *(f"{one.errors[name]:.3f}" for name in errors),
                f"{one.whole:.2f}",
                "–" if one.grown is None else f"{one.grown / 1e6:.0f}",
                ", ".join(front),
            ]
        )
    lines = [aligned(rows), ""]
    chosen = made.proposal.chosen
    if chosen is None:
        lines.append(made.proposal.said)
    else:
        lines += [
            f"proposed: {chosen.called}, as {made.proposal.said}",
            f"options: {chosen.options or 'none, these are the defaults'}",
        ]
    return "\n".join([*lines, f"page: {made.page}"])
