"""Data card of a training set: size, number of refused samples, and settings.

It is the ``README.md`` of the set, with the front matter of Hugging Face's hub. The same set and
settings give the same bytes, as it has no time and no path of the machine.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from flows.config import DatasetSettings
from slgaussian import __version__
from slgaussian.benchmark.reports.model import count_text
from slgaussian.datasets.configs import Bounds
from slgaussian.datasets.training_set import INDEX, SPLITS, TrainingSet
from slgaussian.io import write_atomic

CARD = "README.md"

SETTINGS = ("size", "targets", "held_out", "images", "shard_mb", "near", "far", "trust_cameras")
"""Settings on the card besides those of the method and the choice of samples."""

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

`{index}` has measures of quality of each sample, its position, place and split. The splits have
{counts} samples. All clips of a place are in one split. {refused} frames, clips and samples were
refused; `failures.parquet` has the reasons. Distribution of the set requires the right to
distribute the photographs in it.
{masked}
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

MASKED = """
Photographs of {} are transparent in part. These pixels are black, without depth and labels;
`opaque` in `geometry.npz` is false there, and missing where all is opaque.
"""
"""Paragraph of a set with transparent pixels."""


def write_card(
    out: Path, settings: DatasetSettings, refused: int, stages: Mapping[str, int], masked: int
) -> None:
    """Write the card beside the index of a set; OSError if that fails.

    ``refused`` is the number of failures, ``stages`` has the versions of the stages, and ``masked``
    is the number of samples with transparent pixels.
    """
    rows = TrainingSet(out).rows
    counts = Counter(rows["split"].to_pylist())
    splits = [split for split in SPLITS if counts[split]]
    places = count_text(len(rows["place"].unique()), "place")
    requested = {
        **settings.model_dump(mode="json", include=set(SETTINGS)),
        **dict(Bounds.of(settings)),
        "method": {key: value for key, value in settings.identity.items() if key != "lifting"},
        "stages": dict(stages),
    }
    text = TEXT.format(
        title=f"{count_text(rows.num_rows, 'sample')} of {places}",
        files="".join(f"  - split: {split}\n    path: {split}-*.tar\n" for split in splits),
        targets=count_text(settings.targets, "target view"),
        size=settings.size,
        index=INDEX,
        counts=" and ".join(f"{counts[split]} {split}" for split in splits),
        refused=refused,
        split=splits[0],
        masked=MASKED.format(count_text(masked, "sample")) if masked else "",
        slgaussian=__version__,
        numpy=version("numpy"),
        torch=version("torch"),
        settings=json.dumps(requested, indent=1),
    )
    write_atomic(out / CARD, text.encode())
