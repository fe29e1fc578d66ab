"""Files of a benchmark: masks that any tool reads, and which of an earlier run are deleted."""

import re

import numpy as np
import pytest
from PIL import Image

from slgaussian.benchmark.external_predictions import SCORABLE
from slgaussian.benchmark.outputs import (
    clear_predictions,
    file_name,
    mask_paths,
    write_predictions,
    write_samples,
)
from slgaussian.benchmark.pictures import encode_png
from slgaussian.errors import InputError


def masks_of(result) -> dict[tuple[str, str, str], bytes]:
    return {key: encode_png(mask) for key, mask in result.predictions.items()}


def test_predicted_masks_can_be_read_by_any_tool(tmp_path, result):
    write_predictions(result.rows, masks_of(result), tmp_path)
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(files) == len(result.predictions)
    assert len(files) == sum(row["protocol"].partition("@")[0] in SCORABLE for row in result.rows)
    for (protocol, frame, query), mask in result.predictions.items():
        folder = tmp_path / "slgaussian" / protocol.removesuffix("@2") / result.scene / frame
        path = folder / f"{query}.png"
        metadata = {"protocol": protocol, "frame": frame, "query": query}
        assert tmp_path / mask_paths([{**result.rows[0], **metadata}])[0] == path
        assert np.array_equal(np.asarray(Image.open(path).convert("L")) == 255, mask)


def test_masks_of_an_earlier_run_go_and_nothing_else(tmp_path, result):
    other = [row | {"method": "other"} for row in result.rows]
    for rows in (result.rows, other):
        write_predictions(rows, masks_of(result), tmp_path / "predictions")
    write_samples([*result.rows, *other, {**result.rows[0], "method": "third"}], tmp_path)
    before = set(tmp_path.rglob("*.png"))
    notes = tmp_path / "predictions" / "other" / "notes.txt"
    foreign = tmp_path / "predictions" / "yet another" / "a.png"
    foreign.parent.mkdir()
    for file in (notes, foreign):
        file.write_text("mine")
    emptied = tmp_path / "predictions" / "third" / "slgaussian"
    emptied.mkdir(parents=True)  # the user deleted what was in it
    of_one_query = [row for row in result.rows if row["query"] == result.rows[0]["query"]]
    clear_predictions(of_one_query, tmp_path)
    left = {tmp_path / "predictions" / mask_paths([row])[0] for row in of_one_query} & before
    assert left and set(tmp_path.rglob("*.png")) == left | {foreign} and notes.exists()
    assert not (tmp_path / "predictions" / "other" / "slgaussian").exists()
    assert not emptied.parent.exists()
    # Again, or without a table of samples, nothing happens.
    clear_predictions(of_one_query, tmp_path)
    for table in (b"no table", None):
        samples = tmp_path / "samples.parquet"
        samples.unlink() if table is None else samples.write_bytes(table)
        clear_predictions([], tmp_path)
    assert set(tmp_path.rglob("*.png")) == left | {foreign}


def test_file_names_are_safe_and_differ():
    assert file_name("blue-grey sofa") == "blue-grey sofa"
    odd = ["../etc", "a/b", "a\\b", "a:b", "a?b", ".hidden", "hidden", "é", "", " x", "x"]
    odd += ["l" * 300, "con", "con.txt"]
    names = [file_name(text) for text in odd]
    assert len(set(names)) == len(odd) and not {"con", "con.txt"} & set(names)
    for name in names:
        assert re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._ -]{0,99}", name)


def test_an_unwritable_place_is_named(tmp_path, result):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_samples(result.rows, tmp_path / "file")
