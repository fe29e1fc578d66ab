"""Description of a training set for people and catalogues: card, picture sheet, Croissant.

``README.md`` has the front matter of Hugging Face's hub, ``sheet.jpg`` shows some samples, and
``croissant.json`` (https://mlcommons.org/croissant) describes files and index. The same set and
settings give the same bytes, as they have no time and no path of the machine.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import jinja2
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq

from slgaussian.benchmark import pictures
from slgaussian.benchmark.reports.model import count_text
from slgaussian.datasets.set_versions import Manifest
from slgaussian.datasets.shards import INDEX
from slgaussian.datasets.training_set import TrainingSet
from slgaussian.io import file_sha256, write_atomic
from slgaussian.storage.specs import load_spec

CARD, SHEET = "README.md", "sheet.jpg"

TEMPLATES = {CARD: "card.md.j2", "croissant.json": "croissant.json.j2"}

UNKNOWN = "unknown"
"""Licence of a source for which none was given."""

MEASURES = (
    "overlap", "baseline", "depth", "objects", "confirmed", "explained", "unlabelled",
    "unlabelled_targets", "blur", "clipped",
)  # fmt: skip
"""Columns of the index with statistics on the card."""

SHOWN_SAMPLES, TILE_SIDE = 8, 150
"""Largest number of rows of the picture sheet, and its tiles in pixels."""


def describe_set(out: Path, manifest: Manifest) -> None:
    """Write card, picture sheet and Croissant metadata beside the index; OSError if that fails.

    ``manifest`` is that of the version of the index.
    """
    samples = TrainingSet(out)
    rows, columns = samples.rows, load_spec("training_set").columns
    sources = (
        rows.group_by(["source", "licence"])
        .aggregate([("sample", "count"), ("clip", "count_distinct"), ("place", "count_distinct")])
        .sort_by([("source", "ascending"), ("licence", "ascending")])
        .to_pylist()
    )
    licences = sorted({row["licence"] for row in sources})
    places = count_text(len(rows["place"].unique()), "place")
    digests = {INDEX: file_sha256(out / INDEX), **manifest["shards"]}
    values = {
        **manifest,
        "title": f"{count_text(rows.num_rows, 'sample')} of {places}",
        "licences": licences,
        "licence": licences[0].lower() if len(licences) == 1 else "other",
        "targets": count_text(manifest["settings"]["targets"], "target view"),
        "sheet": SHEET,
        "refused": pq.read_metadata(out / "failures.parquet").num_rows,
        "sources": sources,
        "unlicensed": [f"`{row['source']}`" for row in sources if row["licence"] == UNKNOWN],
        "measures": [
            (name, pc.quantile(rows[name], [0, 0.5, 1]).to_pylist(), columns[name].unit)
            for name in MEASURES
        ],
        "files": [
            {"name": name, "bytes": (out / name).stat().st_size, "sha256": digest}
            for name, digest in digests.items()
        ],
        "columns": columns,
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slgaussian.datasets", "."), undefined=jinja2.StrictUndefined
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False}
    sheet = _draw_sheet(samples)
    write_atomic(out / SHEET, pictures.encode_jpeg(sheet, sheet.shape[1]))
    for name, template in TEMPLATES.items():
        text = environment.get_template(template).render(values)
        write_atomic(out / name, f"{text}\n".encode())


def _draw_sheet(samples: TrainingSet) -> np.ndarray:
    """Draw a row for each of some samples, of as many places as possible; uint8 [H, W, 3]."""
    rows = samples.rows.select(["sample", "place"]).to_pylist()
    ranks = [hashlib.sha256(row["sample"].encode()).hexdigest() for row in rows]
    order = sorted(range(len(rows)), key=ranks.__getitem__)
    first = {*{rows[number]["place"]: number for number in reversed(order)}.values()}
    chosen = sorted(order, key=lambda number: number not in first)
    tiles = []
    for number in chosen[:SHOWN_SAMPLES]:
        item = samples[number]
        context = item["context"]
        images, depths = context["image"].numpy().transpose(0, 2, 3, 1), context["depth"].numpy()
        near, far = pictures.depth_range(*depths)
        labels = map(pictures.paint_labels, context["labels"].numpy(), images)
        painted = [pictures.paint_depth(depth, near, far) for depth in depths]
        captions = item["sample"], item["place"], "labels", "", f"depth {near:.3g} to {far:.3g}", ""
        tiles += list(zip(captions, [*images, *labels, *painted], strict=True))
    return pictures.contact_sheet(tiles, TILE_SIDE, 6)
