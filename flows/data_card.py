"""Data card of a training set: content, quality, number of refused samples, and settings.

It is the ``README.md`` of the set, with the front matter of Hugging Face's hub. The same set and
settings give the same bytes, as it has no time and no path of the machine.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

from flows.clip_sources import Source
from flows.config import DatasetSettings
from slgaussian import __version__
from slgaussian.benchmark.reports.model import count_text
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.training_set import INDEX, SPLITS, TrainingSet
from slgaussian.io import write_atomic

CARD = "README.md"

SETTINGS = {
    "size", "targets", "held_out", "images", "shard_mb", "near", "far", "trust_cameras"
}  # fmt: skip
"""Settings on the card besides those of the method and the choice of samples."""

QUALITY = ("overlap", "baseline", "blur", "unlabelled", "unlabelled_targets", "confirmed")
"""Columns of the index whose medians are on the card."""

TEXT = """\
---
pretty_name: {title}
license: other
configs:
- config_name: default
  data_files:
{files}---

# {title}

Each sample has two context views, {targets} between them, their cameras, depth, object labels that
are consistent between the views, and for each object an ID code and a vector of language features
for each context view. Depth, labels and features are predicted, not measured. All views have
{size[0]}x{size[1]} pixels (height, width).

{table}

Measures of quality are medians; `{index}` has those of each sample, its position, place and split.
All clips of a place are in one split. {refused} frames, clips and samples were refused;
`failures.parquet` has the reasons. Distribution of the set requires the right to distribute the
photographs in it.

The shards are tar files, which `torch`, `webdataset` and `datasets` read:

```python
from slgaussian.datasets import TrainingSet

samples = TrainingSet(".", split="{split}")
```

`slgaussian dataset` of slgaussian {slgaussian} with NumPy {numpy} and PyTorch {torch} made it. The
same sources and settings give the same bytes on the same type of processor:

```json
{settings}
```
"""


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
    rows = TrainingSet(out).rows.to_pylist()
    splits = [split for split in SPLITS if any(row["split"] == split for row in rows)]
    asked = {
        **settings.model_dump(mode="json", include=SETTINGS),
        **dict(Bounds.of(settings)),
        "method": {key: value for key, value in settings.identity.items() if key != "lifting"},
        "stages": dict(stages),
    }
    places = count_text(len({row["place"] for row in rows}), "place")
    text = TEXT.format(
        title=f"{count_text(len(rows), 'sample')} of {places}",
        files="".join(f"  - split: {split}\n    path: {split}-*.tar\n" for split in splits),
        targets=count_text(len(rows[0]["targets"]), "target view"),
        size=settings.size,
        table=_sources_table(rows, sources),
        index=INDEX,
        refused=refused,
        split=splits[0],
        slgaussian=__version__,
        numpy=version("numpy"),
        torch=version("torch"),
        settings=json.dumps(asked, indent=1),
    )
    write_atomic(out / CARD, text.encode())


def _sources_table(rows: Sequence[Mapping[str, Any]], sources: Mapping[str, Source]) -> str:
    """Return a Markdown table of the samples of each source and split, and their quality."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        location = sources[row["sample"]].location
        # Without the path on this machine.
        name = location if "://" in location else Path(location).name
        groups[name, row["split"]].append(row)
    titles = ("source", "split", "cameras", "clips", "samples", *QUALITY)
    lines = [titles, ["---"] * len(titles)]
    for names, members in sorted(groups.items()):
        cameras = "; ".join(sorted({row["cameras"] for row in members}))
        counts = len({row["clip"] for row in members}), len(members)
        quality = (f"{median(row[column] for row in members):.3g}" for column in QUALITY)
        lines.append([*names, cameras, *map(str, counts), *quality])
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
