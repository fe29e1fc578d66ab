"""Description of a training set for people and catalogues: card, picture sheet, Croissant.

``README.md`` has the front matter of Hugging Face's hub, ``sheet.jpg`` shows some samples, and
``croissant.json`` (https://mlcommons.org/croissant) describes files and index. The same set and
settings give the same bytes, as they have no time and no path of the machine.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from slgaussian.benchmark import pictures
from slgaussian.benchmark.reports.model import count_text
from slgaussian.datasets.set_versions import FOLDER, Manifest
from slgaussian.datasets.training_set import INDEX, TrainingSet
from slgaussian.io import file_sha256, write_atomic
from slgaussian.storage.specs import load_spec

CARD, SHEET, CROISSANT = "README.md", "sheet.jpg", "croissant.json"

UNKNOWN = "unknown"
"""Licence of a source for which none was given."""

MEASURES = (
    "overlap", "baseline", "depth", "objects", "confirmed", "explained", "unlabelled",
    "unlabelled_targets", "blur", "clipped",
)  # fmt: skip
"""Columns of the index with statistics on the card."""

SHOWN_SAMPLES, TILE_SIDE = 8, 150
"""Largest number of rows of the picture sheet, and its tiles in pixels."""

TEXT = """\
---
pretty_name: {title}
license: {licence}
configs:
- config_name: default
  data_files:
{files}---

# {title}

Version {version} of this set, digest `{digest}`; `{folder}/` has what came, what went and why, for
each version.

Each sample has two context views, {targets} between them, their cameras, depth, object labels that
are consistent between the views, and for each object an ID code and a vector of language features
for each context view. Depth, labels and features are predicted, not measured. All views have
{size[0]}x{size[1]} pixels (height, width). Transparent pixels of photographs are black, without
depth and labels; `opaque` in `geometry.npz` is false there, and missing where all is opaque.

![Samples: two context views, their labels, and their depth, red near and blue far]({sheet})

`{index}` has measures of quality of each sample, its position, place and split. {refused} frames,
clips and samples were refused; `failures.parquet` has the reasons.

{splits}

All clips of a place are in one split.

{sources}
{unlicensed}
{statistics}

The shards are tar files, which `torch`, `webdataset` and `datasets` read. Take their names from
`{index}` or from above, not from a listing of the folder: shards of the version before, which open
readers need, stay for {keep_days:g} days (`retired.json`).

```python
from slgaussian.datasets import TrainingSet

samples = TrainingSet(".", split="{split}")
```

`slgaussian dataset` of {made} made it. The same sources and settings give the same bytes on the
same type of processor:

```json
{settings}
```
"""

UNLICENSED = """
**The licence of {} is unknown.** Distribution of the set requires the right to distribute the
photographs in it.
"""


def describe_set(out: Path, manifest: Manifest) -> None:
    """Write card, picture sheet and Croissant metadata beside the index; OSError if that fails.

    ``manifest`` is that of the version of the index.
    """
    samples = TrainingSet(out)
    sheet = _draw_sheet(samples)
    write_atomic(out / SHEET, pictures.encode_jpeg(sheet, sheet.shape[1]))
    write_atomic(out / CARD, _write_card(out, samples.rows, manifest).encode())
    text = json.dumps(_describe_files(out, samples.rows, manifest), indent=1, ensure_ascii=False)
    write_atomic(out / CROISSANT, text.encode())


def _write_card(out: Path, rows: pa.Table, manifest: Manifest) -> str:
    settings, made = manifest["settings"], manifest["made"]
    counts = manifest["counts"]
    files = "".join(
        f"  - split: {split}\n    path:\n"
        + "".join(f"    - {name}\n" for name in manifest["shards"] if name.startswith(f"{split}-"))
        for split in counts
    )
    by_source = rows.group_by(["source", "licence"]).aggregate(
        [("sample", "count"), ("clip", "count_distinct"), ("place", "count_distinct")]
    )
    sources = sorted(map(list, zip(*by_source.to_pydict().values(), strict=True)))
    licences = {row[1] for row in sources}
    unknown = [f"`{row[0]}`" for row in sources if row[1] == UNKNOWN]
    statistics = [
        [name, *(f"{value:.3g}" for value in _quantiles(rows[name])), _unit(name)]
        for name in MEASURES
    ]
    software = made["software"]
    return TEXT.format(
        title=_title(rows),
        licence=licences.pop().lower() if len(licences) == 1 else "other",
        files=files,
        version=manifest["version"],
        digest=manifest["digest"],
        folder=FOLDER,
        targets=count_text(settings["targets"], "target view"),
        size=settings["size"],
        sheet=SHEET,
        index=INDEX,
        refused=pq.read_metadata(out / "failures.parquet").num_rows,
        splits=_table(
            ["split", "samples", "clips", "places"],
            [[split, *count.values()] for split, count in counts.items()],
        ),
        sources=_table(["source", "licence", "samples", "clips", "places"], sources),
        unlicensed=UNLICENSED.format(", ".join(unknown)) if unknown else "",
        statistics=_table(["measure", "least", "median", "most", "unit"], statistics),
        keep_days=settings["keep_old_days"],
        split=min(counts, key=lambda split: split != "train"),
        made=f"{made['program']} with NumPy {software['numpy']} and PyTorch {software['torch']}",
        settings=json.dumps(settings, indent=1),
    )


def _title(rows: pa.Table) -> str:
    places = count_text(len(rows["place"].unique()), "place")
    return f"{count_text(rows.num_rows, 'sample')} of {places}"


def _table(head: list[str], rows: list[list[Any]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def _quantiles(column: pa.ChunkedArray) -> list[float]:
    return pc.quantile(column, [0, 0.5, 1]).to_pylist()


def _unit(name: str) -> str:
    unit = load_spec("training_set").columns[name].unit
    return "" if unit == "1" else unit


def _draw_sheet(samples: TrainingSet) -> np.ndarray:
    """Draw a row for each of some samples, of as many places as possible; uint8 [H, W, 3]."""
    rows = samples.rows.select(["sample", "place"]).to_pylist()
    order = sorted(range(len(rows)), key=lambda n: _rank(rows[n]["sample"]))
    first = {rows[n]["place"]: n for n in reversed(order)}
    chosen = sorted(order, key=lambda n: first[rows[n]["place"]] != n)[:SHOWN_SAMPLES]
    tiles = []
    for number in chosen:
        item = samples[number]
        context, name = item["context"], item["sample"]
        images = context["image"].numpy().transpose(0, 2, 3, 1)
        depths = context["depth"].numpy()
        near, far = pictures.depth_range(*depths)
        labels = map(pictures.paint_labels, context["labels"].numpy(), images)
        tiles += [(name, images[0]), (item["place"], images[1])]
        tiles += [(text, image) for text, image in zip(("labels", ""), labels, strict=True)]
        tiles += [(f"depth {near:.3g} to {far:.3g}", pictures.paint_depth(depths[0], near, far))]
        tiles += [("", pictures.paint_depth(depths[1], near, far))]
    return pictures.contact_sheet(tiles, TILE_SIDE, 6)


def _rank(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()


CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "recordSet": "cr:recordSet",
    "repeated": "cr:repeated",
    "source": "cr:source",
}
"""Terms of Croissant 1.0 that are used."""

DATA_TYPES = {"string": "sc:Text", "int64": "sc:Integer", "float64": "sc:Float"}


def _describe_files(out: Path, rows: pa.Table, manifest: Manifest) -> dict[str, Any]:
    """Describe index and shards, each with its SHA-256, and the columns of the index."""

    def file(name: str, kind: str, digest: str) -> dict[str, str]:
        return {
            "@type": "cr:FileObject",
            "@id": name,
            "name": name,
            "contentUrl": name,
            "contentSize": f"{(out / name).stat().st_size} B",
            "encodingFormat": kind,
            "sha256": digest,
        }

    fields = [
        {
            "@type": "cr:Field",
            "@id": f"samples/{name}",
            "name": f"samples/{name}",
            "description": column.doc,
            "dataType": DATA_TYPES[column.type.removesuffix(" list")],
            **({"repeated": True} if column.type.endswith(" list") else {}),
            "source": {"fileObject": {"@id": INDEX}, "extract": {"column": name}},
        }
        for name, column in load_spec("training_set").columns.items()
    ]
    index = file(INDEX, "application/x-parquet", file_sha256(out / INDEX))
    return {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": "slgaussian-training-set",
        "description": f"{_title(rows)}: photographs, cameras, depth, object labels and language "
        f"features. Depth, labels and features are predicted. Digest {manifest['digest']}.",
        "license": sorted(rows["licence"].unique().to_pylist()),
        "version": f"{manifest['version']}.0.0",
        "distribution": [
            index,
            *(file(n, "application/x-tar", digest) for n, digest in manifest["shards"].items()),
        ],
        "recordSet": [
            {
                "@type": "cr:RecordSet",
                "@id": "samples",
                "name": "samples",
                "description": "A row for each sample: its position in a shard, and its quality.",
                "field": fields,
            }
        ],
    }
