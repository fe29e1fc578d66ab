"""Data card of a training set: content, quality and number of refused samples.

It is the ``README.md`` of the set. The same set and settings give the same bytes, as it has no time
and no path of the machine.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flows.clip_sources import Source
from flows.config import DatasetSettings, SetSettings
from slgaussian import __version__
from slgaussian.benchmark.reports.model import Column, Prose, Report, Section, Table, count_text
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.training_set import INDEX, SPECS, SPLITS, TrainingSet
from slgaussian.io import write_atomic
from slgaussian.storage.specs import load_spec

CARD = "README.md"

QUALITY = (
    "overlap", "baseline", "blur", "clipped", "unlabelled", "unlabelled_targets", "confirmed",
    "explained", "objects",
)  # fmt: skip
"""Columns of the index whose quantiles are on the card."""

READING = """\
```python
from torch.utils.data import DataLoader
from slgaussian.datasets import TrainingSet

samples = TrainingSet(".", split="{split}")
loader = DataLoader(samples, batch_size=4, shuffle=True, num_workers=2)
```

```python
import glob

import webdataset

shards = sorted(glob.glob("{split}-*.tar"))
samples = webdataset.WebDataset(shards, shardshuffle=False).decode("rgb8")
```

```python
import datasets

samples = datasets.load_dataset(".", split="{split}")  # or "webdataset" with data_files
```

The shards are tar files. `{index}` has one row per sample: its position, place, split and quality.
Members of the first sample:"""


def write_card(
    out: Path,
    settings: DatasetSettings,
    sources: Mapping[str, Source],
    refused: int,
    stages: Mapping[str, int],
) -> None:
    """Write the card beside the index of a set; OSError if that fails.

    ``sources`` has the source of each sample, ``refused`` is the number of failures, and ``stages``
    has the versions of the stages.
    """
    samples = TrainingSet(out)
    rows = samples.rows.to_pylist()
    splits = [split for split in SPLITS if any(row["split"] == split for row in rows)]
    places = len({row["place"] for row in rows})
    title = f"{count_text(len(rows), 'sample')} of {count_text(places, 'place')}"
    content = Prose(
        f"Each sample has two context views, {count_text(len(rows[0]['targets']), 'target view')} "
        "between them, their cameras, depth, object labels that are consistent between the views, "
        "and for each object an ID code and a vector of language features for each context view. "
        "Depth, labels and features are predicted, not measured. All views have "
        f"{settings.size[0]}x{settings.size[1]} pixels (height, width)."
    )
    split_rule = Prose(
        "All clips of a place are in one split. Clips show one place if the user said so, if they "
        "are from one video, or if they share a photograph."
    )
    reading = Prose(READING.format(split=splits[0], index=INDEX))
    rights = Prose(
        "Distribution of the set requires the right to distribute the photographs in it."
    )
    refusals = Prose(
        f"{refused} frames, clips and samples were refused. `failures.parquet` has the reasons."
    )
    stage_versions = ", ".join(f"{name} {number}" for name, number in stages.items())
    versions = Prose(
        f"`slgaussian dataset` of slgaussian {__version__} with NumPy {version('numpy')} and "
        f"PyTorch {version('torch')}; versions of the stages: {stage_versions}. The same sources "
        "and settings give the same bytes on the same type of processor."
    )
    sections = [
        Section("Reading it", [reading, _members_table(samples)]),
        Section("Quality", [_quality_table(samples.rows)]),
        Section("Sources", [_sources_table(rows, sources), rights]),
        Section("Refused samples", [refusals]),
        Section("Provenance", [versions, Table.of_values(_asked(settings))]),
    ]
    report = Report(title, [content, _splits_table(out, rows, splits), split_rule], sections)
    files = "".join(f"  - split: {split}\n    path: {split}-*.tar\n" for split in splits)
    front = f"""---
pretty_name: {title}
license: other
configs:
- config_name: default
  data_files:
{files}---

"""
    write_atomic(out / CARD, (front + report.as_markdown()).encode())


def _splits_table(out: Path, rows: Sequence[Mapping[str, Any]], splits: Sequence[str]) -> Table:
    lines = []
    for split in splits:
        split_rows = [row for row in rows if row["split"] == split]
        shards = {row["shard"] for row in split_rows}
        size = sum((out / shard).stat().st_size for shard in shards)
        counts = [len({row[name] for row in split_rows}) for name in ("place", "clip", "sample")]
        lines.append((split, *map(str, (*counts, len(shards))), f"{size / 1e6:.1f}"))
    return Table.of(["split", "places", "clips", "samples", "shards", "MB"], lines)


def _members_table(samples: TrainingSet) -> Table:
    """Describe the members of the first sample."""
    lines = []
    for name in samples.members(0):
        stem, _, ending = name.partition(".")
        if ending == "npz":
            spec = load_spec(SPECS[stem])
            text = f"{spec.doc} {', '.join(spec.fields)}"
        elif ending == "json":
            text = "Its row of the index, and the URL of its video if there is one."
        else:
            text = "Photograph, undistorted, RGB."
        lines.append((name, text))
    return Table.of(["member", Column("content", is_text=True)], lines)


def _quality_table(rows: pa.Table) -> Table:
    columns = load_spec("training_set").columns
    lines = []
    for name in QUALITY:
        quantiles = np.quantile(rows[name].to_numpy(), (0.05, 0.5, 0.95))
        lines.append((name, *(f"{value:.3g}" for value in quantiles), columns[name].doc))
    return Table.of(["column", "5 %", "median", "95 %", Column("meaning", is_text=True)], lines)


def _sources_table(rows: Sequence[Mapping[str, Any]], sources: Mapping[str, Source]) -> Table:
    by_source: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        source = sources[row["sample"]]
        # Without the path on this machine.
        name = Path(source.location).name if "://" not in source.location else source.location
        by_source[name].append(row)
    lines = [
        (
            name,
            str(len({row["clip"] for row in source_rows})),
            str(len(source_rows)),
            "; ".join(sorted({row["cameras"] for row in source_rows})),
        )
        for name, source_rows in sorted(by_source.items())
    ]
    return Table.of(["source", "clips", "samples", Column("cameras", is_text=True)], lines)


def _asked(settings: DatasetSettings) -> dict[str, Any]:
    """Return the settings on which the samples depend, files by digest."""
    fields = {*SetSettings.model_fields, "near", "far", "trust_cameras"}
    values = settings.model_dump(mode="json", include=fields)
    identity = {key: value for key, value in settings.identity.items() if key != "lifting"}
    return {**values, **dict(Bounds.of(settings)), "method": identity}
