"""Files of a benchmark: masks that any tool reads, as run lengths and as PNG files."""

import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from pycocotools import mask as coco

from slgaussian.benchmark import outputs
from slgaussian.benchmark.external_predictions import SCORABLE, read_predictions
from slgaussian.benchmark.outputs import (
    export_masks,
    file_name,
    mask_paths,
    write_masks,
    write_samples,
)
from slgaussian.benchmark.scores import Rows
from slgaussian.errors import InputError, SpecError
from slgaussian.formats import rle


def write(out, result, methods=("slgaussian",)) -> None:
    masks = {key: rle.encode(mask) for key, mask in result.predictions.items()}
    write_masks(((method, result.scene, masks) for method in methods), out)


def test_write_masks_is_readable_by_other_tools(tmp_path, result, monkeypatch):
    monkeypatch.setattr(outputs, "MASKS_IN_MEMORY", 3)
    write(tmp_path, result, ("slgaussian", "other"))
    names = ("protocol", "frame", "query")
    filters = [("method", "==", "other")]
    rows = pq.read_table(tmp_path / "masks.parquet", filters=filters).to_pylist()
    assert {tuple(row[name] for name in names) for row in rows} == result.predictions.keys()
    assert len(rows) == sum(row["protocol"].partition("@")[0] in SCORABLE for row in result.rows)
    for row in rows:
        mask = coco.decode({"size": [row["height"], row["width"]], "counts": row["counts"]})
        assert np.array_equal(mask, result.predictions[tuple(row[name] for name in names)])
    assert export_masks(tmp_path / "masks.parquet", tmp_path / "png") == 2 * len(rows)
    for (protocol, frame, query), mask in result.predictions.items():
        folder = tmp_path / "png" / "other" / protocol.removesuffix("@2") / result.scene / frame
        path = folder / f"{query}.png"
        metadata = {"method": "other", "protocol": protocol, "frame": frame, "query": query}
        assert tmp_path / "png" / mask_paths([{**result.rows[0], **metadata}])[0] == path
        assert np.array_equal(np.asarray(Image.open(path).convert("L")) == 255, mask)


def test_write_masks_replaces_an_earlier_file_as_a_whole(tmp_path, result):
    write(tmp_path, result, ("slgaussian", "other"))
    file = tmp_path / "masks.parquet"
    before = file.read_bytes()
    with pytest.raises(ZeroDivisionError):
        write_masks((("third", f"{1 // n}", {}) for n in (1, 0)), tmp_path)
    assert file.read_bytes() == before and list(tmp_path.iterdir()) == [file]
    write(tmp_path, result)
    assert {key[0] for key in read_predictions(tmp_path).masks} == {"slgaussian"}
    write(tmp_path / "again", result)
    assert (tmp_path / "again" / "masks.parquet").read_bytes() == file.read_bytes()
    file.write_bytes(before[:-9])
    with pytest.raises(SpecError, match=r"masks\.parquet: file: found \d+ bytes that cannot"):
        read_predictions(tmp_path)


def test_file_name_is_safe_and_unique():
    assert file_name("blue-grey sofa") == "blue-grey sofa"
    odd = ["../etc", "a/b", "a\\b", "a:b", "a?b", ".hidden", "hidden", "é", "", " x", "x"]
    odd += ["l" * 300, "con", "con.txt"]
    names = [file_name(text) for text in odd]
    assert len(set(names)) == len(odd) and not {"con", "con.txt"} & set(names)
    for name in names:
        assert re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._ -]{0,99}", name)


def test_outputs_name_an_unwritable_place(tmp_path, result):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_samples(Rows.from_rows(result.rows), tmp_path / "file")
