"""Data card of a training set: content, quality, licences and number of refused samples.

It is a ``README.md`` with a contact sheet. The same set and settings give the same bytes, as it has
no time and no path of the machine.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pyarrow as pa

from flows.clip_sources import Source
from flows.config import DatasetSettings, SetSettings
from slgaussian import __version__, datasets
from slgaussian.benchmark.pictures import (
    contact_sheet,
    depth_range,
    encode_jpeg,
    paint_depth,
    paint_labels,
)
from slgaussian.datasets import licences
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.training_set import INDEX, SPECS, SPLITS, TrainingSet
from slgaussian.io import write_atomic
from slgaussian.storage.specs import load_spec
from tasks.chunks import Room

CARD, SHEET = "README.md", "sheet.jpg"

SHEET_ROWS, SHEET_SIDE = 12, 144
"""Largest number of samples on the contact sheet, and height of its pictures in pixels."""

SHEET_WIDE = 2400
"""Largest width of the contact sheet in pixels."""

QUALITY = (
    "overlap", "baseline", "blur", "clipped", "unlabelled", "unlabelled_targets", "confirmed",
    "explained", "objects",
)  # fmt: skip
"""Columns of the index whose quantiles are on the card."""


def write_card(
    out: Path,
    settings: DatasetSettings,
    sources: Mapping[str, Source],
    refused: int,
    stages: Mapping[str, int],
) -> None:
    """Write the card and its contact sheet beside the index of a set; OSError if that fails.

    ``sources`` has the source of each sample, ``refused`` is the number of failures, and ``stages``
    has the versions of the stages.
    """
    samples = TrainingSet(out)
    write_atomic(out / SHEET, encode_jpeg(_sheet(samples), SHEET_WIDE))
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["cell"] = lambda text: " ".join(str(text).split()).replace("|", "\\|")
    template = environment.from_string((files("flows") / "data_card.md.j2").read_text("utf-8"))
    page = template.render(
        **_counts(out, samples.rows),
        size=f"{settings.size[0]}x{settings.size[1]}",
        settings=settings,
        first=_size_category(len(samples)),
        quantiles=_quantiles(samples.rows),
        members=_members(samples),
        sources=_sources(samples.rows, sources),
        refused=refused,
        asked=json.dumps(_asked(settings), indent=1, sort_keys=True),
        versions={"slgaussian": __version__, "numpy": version("numpy"), "torch": version("torch")},
        stages=", ".join(f"{name} {number}" for name, number in stages.items()),
        sheet=SHEET,
        index=INDEX,
    )
    write_atomic(out / CARD, page.encode())


def _counts(out: Path, rows: pa.Table) -> dict[str, Any]:
    table = rows.to_pylist()
    splits = []
    for split in SPLITS:
        split_rows = [row for row in table if row["split"] == split]
        if split_rows:
            shards = sorted({row["shard"] for row in split_rows})
            size = sum((out / shard).stat().st_size for shard in shards)
            counts = [len({row[name] for row in split_rows}) for name in ("place", "clip")]
            splits.append((split, *counts, len(split_rows), len(shards), f"{size / 1e6:.1f}"))
    return {
        "splits": splits,
        "samples": len(table),
        "places": len({row["place"] for row in table}),
        "targets": len(table[0]["targets"]),
    }


def _size_category(samples: int) -> str:
    """Return the size category of the Hugging Face hub."""
    steps = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"))
    return next((name for limit, name in steps if samples < limit), "100K<n<1M")


def _quantiles(rows: pa.Table) -> list[tuple[str, str, str, str, str]]:
    spec = load_spec("training_set")
    lines = []
    for name in QUALITY:
        low, middle, high = np.quantile(rows[name].to_numpy(), (0.05, 0.5, 0.95))
        lines.append((name, f"{low:.3g}", f"{middle:.3g}", f"{high:.3g}", spec.columns[name].doc))
    return lines


def _members(samples: TrainingSet) -> list[tuple[str, str, str]]:
    """Return the members of the first sample with their kilobytes."""
    members = []
    for name, data in samples.members(0).items():
        stem, _, ending = name.partition(".")
        if ending == "npz":
            spec = load_spec(SPECS[stem])
            text = f"{spec.doc} {', '.join(spec.fields)}"
        elif ending == "json":
            text = "Its row of the index, and the URL of its video if there is one."
        else:
            text = "Photograph, undistorted, RGB."
        members.append((name, f"{len(data) / 1e3:.0f}", text))
    return members


def _sources(rows: pa.Table, sources: Mapping[str, Source]) -> list[tuple[str, int, int, str, str]]:
    by_source: dict[str, list[dict[str, Any]]] = defaultdict(list)
    stated: dict[str, str] = {}
    for row in rows.to_pylist():
        source = sources[row["sample"]]
        # Without the path on this machine.
        name = Path(source.location).name if "://" not in source.location else source.location
        by_source[name].append(row)
        stated[name] = _licence(source)
    return [
        (
            name,
            len({row["clip"] for row in source_rows}),
            len(source_rows),
            "; ".join(sorted({row["cameras"] for row in source_rows})),
            stated[name],
        )
        for name, source_rows in sorted(by_source.items())
    ]


def _licence(source: Source) -> str:
    if isinstance(source.holds, Room):
        return ", ".join(datasets.SOURCES["procedural"])
    path = source.holds if isinstance(source.holds, str) else source.holds.path
    return licences.stated(Path(path)) or "none found beside the data: ask their author"


def _asked(settings: DatasetSettings) -> dict[str, Any]:
    """Return the settings on which the samples depend, files by digest."""
    fields = {*SetSettings.model_fields, "near", "far", "trust_cameras"}
    values = settings.model_dump(mode="json", include=fields)
    identity = {key: value for key, value in settings.identity.items() if key != "lifting"}
    return {**values, **dict(Bounds.of(settings)), "method": identity}


def _sheet(samples: TrainingSet) -> np.ndarray:
    """Draw evenly chosen samples: each view, its labels and its depth."""
    count = min(SHEET_ROWS, len(samples))
    tiles: list[tuple[str, np.ndarray]] = []
    for index in np.linspace(0, len(samples) - 1, count).round().astype(int).tolist():
        item = samples[index]
        depths = [item[role]["depth"].numpy() for role in ("context", "target")]
        near, far = depth_range(*[depth[depth > 0] for depth in depths])
        caption = item["sample"]
        for role, depth in zip(("context", "target"), depths, strict=True):
            views = item[role]
            for number, image in enumerate(views["image"].numpy().transpose(0, 2, 3, 1)):
                image = np.ascontiguousarray(image)
                labels = views["labels"][number].numpy().astype(np.int32)
                unlabelled = f"{(labels == 0).mean():.0%} without an id"
                tiles += [
                    (caption or f"{role} {number}", image),
                    (unlabelled, paint_labels(labels, image)),
                    (f"depth of {role} {number}", paint_depth(depth[number], near, far)),
                ]
                caption = ""
    return contact_sheet(tiles, SHEET_SIDE, len(tiles) // count)
