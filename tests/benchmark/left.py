"""Folders as runs leave them, of results that may be changed."""

import json
from pathlib import Path

from slgaussian.benchmark.outputs import write_file, write_predictions, write_samples
from slgaussian.benchmark.pictures import encode_png

MANIFEST = {
    "settings": {"share": 0.7, "seed": 0},
    "methods": {"query-2d": "query-2d"},
    "data": {"procedural_3": {"sample": "aa", "files": {"a.png": "11"}}},
}


def leave(folder: Path, result, change=lambda row: row, manifest=MANIFEST) -> Path:
    """What a run leaves in a folder, of rows that may be changed first."""
    rows = [change(dict(row)) for row in result.rows]
    rows = [row for row in rows if row is not None]
    write_samples(rows, folder)
    masks = {key: encode_png(mask) for key, mask in result.predictions.items()}
    write_predictions(rows, masks, folder / "predictions")
    write_file(folder / "manifest.json", json.dumps(manifest).encode())
    return folder
