"""A splat among the arguments of a command, and renderings in place of its photographs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flows.config import Settings
from slgaussian.datasets.recognise import cameras_in
from slgaussian.errors import InputError
from slgaussian.formats.splats import READERS
from slgaussian.scene import Sample
from slgaussian.storage.field_folder import FIELD_FILE


def choose_splat(
    photos: Sequence[str], photographs: Sequence[str], values: dict[str, Any]
) -> tuple[list[str], dict[str, Any]]:
    """Separate a splat from photographs, and choose the predictor ``gaussians`` for it.

    Args:
        photos: Arguments of the command, of which one may be a splat, by its suffix.
        photographs: Those of the option of this name, which needs a splat.
        values: Settings in the form of a configuration file.

    Returns:
        All photographs, and the settings.

    Raises:
        InputError: If there are several splats, none where one is needed, or another predictor.
    """
    splats = [photo for photo in photos if Path(photo).suffix.lower() in READERS]
    if not splats and (not photographs or values.get("predictor") == "gaussians"):
        return [*photos, *photographs], values
    if fields := [photo for photo in photos if (Path(photo) / FIELD_FILE).is_file()]:
        raise InputError(
            f"{fields[0]}: is a field, which answers words already; ask it by `slgaussian query`, "
            "or write its Gaussians as a splat by `slgaussian export`"
        )
    if len(splats) != 1:
        given = ", ".join((splats or [*photos])[:4])
        raise InputError(f"field: found {given}, expected one splat, {' or '.join(READERS)}")
    if values.get("predictor", "gaussians") != "gaussians":
        raise InputError(
            f"predictor: found {values['predictor']!r} and the splat {splats[0]}, whose Gaussians "
            "exist already; leave out the one or the other"
        )
    others = [photo for photo in photos if photo not in splats]
    table = {**values.get("gaussians", {}), "splat": splats[0]}
    return [*others, *photographs], {**values, "predictor": "gaussians", "gaussians": table}


def render_splat(cameras: Path | None, settings: Settings) -> tuple[Sample, dict[str, str]]:
    """Render views of the splat of the settings at cameras, or along a path around it.

    Returns:
        sample: Sample
        places: dict str -> str. The absolute path of the splat by its name.

    Raises:
        InputError: If the splat or the cameras cannot be read, or show nothing of each other.
    """
    from slgaussian.predict.splat_views import render_sample, surround

    config = settings.configure("predictor")
    splat = Path(dict(config)["splat"])
    gaussians = config.load().read(splat.stem)
    views = surround(gaussians) if cameras is None else cameras_in(cameras)
    rendered = "along a path around the splat" if cameras is None else "at the given cameras"
    print(
        f"no photographs: {len(views)} views of the splat are rendered {rendered}", file=sys.stderr
    )
    sample = render_sample(splat.stem, gaussians, views, settings.size, rendered)
    return sample, {splat.name: str(splat.absolute())}
