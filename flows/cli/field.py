"""Build a field from photographs, and print what it is."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flows.cli.load_views import load_views
from flows.cli.render import account_lines
from flows.settings import make_settings
from slgaussian import ahead
from slgaussian.build import build_field
from slgaussian.cameras.quality import Quality
from slgaussian.field import SemanticField
from slgaussian.storage.field_folder import check_target
from slgaussian.storage.inputs import describe_photographs
from slgaussian.things import COMMON_THINGS


def build(
    photos: Sequence[str],
    cameras: Path | None,
    refine: bool,
    keyframes: int | None,
    out: Path,
    values: dict[str, Any],
) -> None:
    """Build a field from photographs, save it to folder ``out``, and print what it is.

    Photographs, cameras and keyframes are as :func:`flows.cli.load_views.load_views` takes them;
    ``values`` are settings as a configuration file has them.

    Raises
    ------
    InputError
        If anything given cannot be used; a folder that cannot be written is found before the work.
    """
    settings = make_settings(values, "field")
    check_target(out)
    start = time.perf_counter()
    sample, places = load_views(photos, cameras, refine, settings, keyframes)
    seconds = {"cameras" if cameras is None else "reading": time.perf_counter() - start}
    ahead.begin()
    height, width = sample.context[0].image.shape[:2]
    components = ", ".join(part.name for part in settings.built_by.components)
    print(
        f"building a field from {len(sample.context)} views of {width}x{height} with {components}",
        file=sys.stderr,
    )
    field = build_field(sample, settings.built_by, settings.trust_cameras, seconds.__setitem__)
    field.save(out, describe_photographs(places))
    size = f"{len(field.gaussians)} Gaussians, {len(field.bank)} objects"
    lines = [f"{size}, {time.perf_counter() - start:.1f} s"]
    quality = Quality(**field.settings["quality"])
    lines += [f"warning: {warning}" for warning in quality.warnings()]
    spent = ", ".join(f"{step} {taken:.2f}" for step, taken in seconds.items())
    lines += [quality.summary(), *account_lines(field), f"seconds: {spent}"]
    word = word_to_ask(field)
    if word is not None:
        command = ["slgaussian", "query", str(out), word, "-o", "hit.png"]
        lines.append(f"ask it: {shlex.join(command)}")
    lines.append(f"look at it: {shlex.join(['slgaussian', 'view', str(out)])}")
    print("\n".join(lines), file=sys.stderr)


def word_to_ask(field: SemanticField) -> str | None:
    """Choose the common thing that a query finds most surely in the first view; None if none is."""
    if field.settings["encoder"] != "lexicon":  # nobody measured how sure others are
        return None
    view = field.render(next(iter(field.cameras.values())))
    sure = {
        hit.text: hit.confidence.mask
        for hit in view.query_all(COMMON_THINGS)
        if hit.found and hit.confidence is not None
    }
    return max(sure, key=sure.__getitem__, default=None)
