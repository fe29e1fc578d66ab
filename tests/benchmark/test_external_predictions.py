"""Masks of other programs are scored like those of a run, or refused in one sentence."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from slgaussian.benchmark.annotations import Truth
from slgaussian.benchmark.evaluate import ABSENT
from slgaussian.benchmark.external_predictions import (
    NOT_GIVEN,
    SCORABLE,
    JudgedScene,
    read_predictions,
    score_predictions,
)
from slgaussian.benchmark.outputs import export_masks, mask_paths, write_masks
from slgaussian.benchmark.pictures import encode_png
from slgaussian.benchmark.protocols import load_protocol
from slgaussian.errors import InputError
from slgaussian.formats import rle
from slgaussian.storage.specs import load_spec
from tests.run_lengths import encode

OF_MASKS = ("iou", "boundary_iou", "class_iou", "accuracy", "height", "width")


@pytest.fixture(scope="module")
def scene(room, result):
    """The scene of the rooms' fixture, without the query that has no ground truth."""
    return JudgedScene(result.scene, result.dataset, "a place", Truth(room.strange_truth))


@pytest.fixture
def folder(tmp_path, result):
    """Masks of a benchmark of that scene, as PNG files."""
    masks = {key: rle.encode(mask) for key, mask in result.predictions.items()}
    write_masks([("slgaussian", result.scene, masks)], tmp_path)
    export_masks(tmp_path / "masks.parquet", tmp_path / "run" / "predictions")
    return tmp_path / "run"


@pytest.fixture
def entries(result):
    """The masks of the first protocol as entries of a JSON file."""
    return make_entries(result)


def make_entries(result, protocol="slgaussian@2", text=True):
    entries = []
    for row in result.rows:
        if row["protocol"] == protocol and row["frame"] == "view_01":
            mask = result.predictions[protocol, "view_01", row["query"]]
            flat = mask.ravel(order="F")
            starts = np.flatnonzero(np.diff(flat, prepend=False))
            counts = np.diff(starts, prepend=0, append=flat.size).tolist()
            entry = {name: row[name] for name in ("scene", "frame", "query")}
            entry |= {"size": list(mask.shape), "counts": encode(mask) if text else counts}
            if row["point_x"] is not None:
                entry["point"] = [row["point_x"], row["point_y"]]
            entries.append(entry)
    return entries


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def score(place, scene, *protocols):
    predictions = read_predictions(place, protocols)
    chosen = [load_protocol(name) for name in protocols or predictions.protocols]
    (result,) = score_predictions(predictions, [scene], chosen)
    return result, predictions


def by_key(rows):
    return {(row["protocol"], row["frame"], row["query"]): row for row in rows}


def test_score_predictions_repeats_scores_of_a_run(folder, result, scene):
    rescored, predictions = score(folder, scene)
    assert predictions.methods == {"slgaussian": tuple(sorted(SCORABLE))}
    rows, theirs = by_key(rescored.rows), by_key(result.rows)
    scorable = {
        key for key in theirs if key[1] == "view_01" and key[0].partition("@")[0] in SCORABLE
    }
    assert rows.keys() == scorable
    for key, row in rows.items():
        assert list(row) == list(load_spec("samples").columns)
        assert [row[name] for name in OF_MASKS] == [theirs[key][name] for name in OF_MASKS]
        # What masks do not say is not said.
        assert row["score"] is row["point_x"] is row["hit_mask"] is row["hit_peak"] is None
        assert row["selection"] == "given" and row["temperature"] is None
        assert row["place"] == "a place"
    assert any(row["accuracy"] for row in rescored.rows) and any(
        r["class_iou"] for r in rescored.rows
    )
    assert rows["slgaussian@2", "view_01", "red sofa"]["note"] == ABSENT
    unused = predictions.extra
    assert unused and all(" in halfway of " in name for name in unused)
    for key, mask in rescored.predictions.items():
        assert np.array_equal(mask, result.predictions[key])
    assert predictions.missing == []
    assert rescored.scene_metrics["iou"] == result.scene_metrics["iou"]


def test_score_predictions_uses_protocols_of_the_masks(folder, scene):
    masks = folder / "predictions"
    shutil.copytree(masks / "slgaussian" / "langsplat", masks / "another" / "langsplat")
    predictions = read_predictions(folder)
    assert list(predictions.methods) == ["slgaussian", "another"]
    chosen = [load_protocol(name) for name in predictions.protocols]
    ours, other = score_predictions(predictions, [scene], chosen)
    assert (ours.method, other.method) == ("slgaussian", "another")
    assert {row["protocol"] for row in other.rows} == {"langsplat@2"}


@pytest.mark.parametrize("text", [True, False])
def test_score_predictions_scores_run_lengths_with_points(tmp_path, result, scene, text):
    file = write(tmp_path / "mine.json", make_entries(result, text=text))
    rescored, predictions = score(file, scene, "slgaussian")
    rows, theirs = by_key(rescored.rows), by_key(result.rows)
    assert rescored.method == "mine" and predictions.methods == {"mine": ()}
    assert len(rows) == len(scene.truth.masks["view_01"])
    for key, row in rows.items():
        names = ["iou", "boundary_iou", "point_x", "point_y"]
        names += ["hit_mask", "hit_box"] if row["point_x"] is not None else []
        assert [row[name] for name in names] == [theirs[key][name] for name in names]
        assert row["class_iou"] is None
    assert any(row["hit_mask"] for row in rows.values())
    box = by_key(score(file, scene, "langsplat")[0].rows)["langsplat@2", "view_01", "qqwx"]
    assert box["hit_box"] is None and box["iou"] == 0


def test_score_predictions_refuses_overlap_where_texts_compete(tmp_path, result, scene):
    entries = [{**entry, "method": "ours"} for entry in make_entries(result, "3d-ovs@2")]
    file = write(tmp_path / "own.json", entries)
    rescored, _ = score(file, scene, "slgaussian", "3d-ovs")
    theirs = by_key(result.rows)
    for (protocol, *rest), row in by_key(rescored.rows).items():
        assert row["class_iou"] == theirs["slgaussian@2", *rest]["class_iou"]
        if protocol == "3d-ovs@2":
            assert row["accuracy"] == theirs[protocol, *rest]["accuracy"] > 0
    assert rescored.method == "ours"
    entries[-1]["counts"] = encode(np.ones((104, 144), bool))
    write(file, entries)
    with pytest.raises(InputError, match=r"own\.json: \[\d+\], .* overlaps the mask of '"):
        score(file, scene, "3d-ovs")
    assert score(file, scene, "slgaussian")


def test_score_predictions_counts_a_missing_mask_as_empty(folder, result, scene):
    query = next(q for q, mask in scene.truth.masks["view_01"].items() if mask.any())
    for text in (query, "red sofa"):  # of the second there is no truth: no sample
        row = {**result.rows[0], "query": text, "protocol": "slgaussian@2"}
        (folder / "predictions" / mask_paths([row])[0]).unlink()
    rescored, predictions = score(folder, scene, "slgaussian")
    rows = by_key(rescored.rows)
    row = rows["slgaussian@2", "view_01", query]
    assert (row["iou"], row["note"]) == (0, NOT_GIVEN)
    assert rows["slgaussian@2", "view_01", "red sofa"]["note"] == ABSENT
    assert predictions.samples == sum(m.any() for m in scene.truth.masks["view_01"].values())
    assert predictions.missing == [f"{query!r} in view_01 of {scene.scene}"]
    assert ("slgaussian@2", "view_01", query) not in rescored.predictions


def test_score_predictions_matches_plain_names_and_frames(tmp_path, scene):
    query, other = list(scene.truth.masks["view_01"].values())[:2]
    odd = Truth({"left/view_01.jpg": {"café": query, "a?b": other}})
    scene = replace(scene, scene="Zuhause, oben", truth=odd)
    plain = tmp_path / "p" / "My method!" / "slgaussian" / scene.scene / "view_01" / "café.png"
    row = {"method": "x", "protocol": "slgaussian@2", "scene": scene.scene, "query": "a?b"}
    safe = mask_paths([{**row, "frame": "left/view_01.jpg"}])[0]
    safe = tmp_path / "p" / "My method!" / safe.relative_to(safe.parts[0])
    for path, mask in ((plain, query), (safe, other)):
        path.parent.mkdir(parents=True)
        Image.fromarray(mask).save(path)
    rescored, predictions = score(tmp_path / "p", scene)
    assert [row["iou"] for row in rescored.rows] == [1, 1] and not predictions.missing
    assert rescored.method == "My method!" and not predictions.extra
    entry = {"scene": scene.scene, "query": "café", "size": [104, 144], "counts": encode(query)}
    for frame in ("left/view_01.jpg", "left/view_01", "view_01"):
        file = write(tmp_path / "m.json", [{**entry, "frame": frame}])
        rescored, predictions = score(file, scene)
        assert [row["iou"] for row in rescored.rows] == [1, 0] and len(predictions.missing) == 1


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda png: png[: len(png) // 2], "; save the mask as a grey PNG, 0"),
        (lambda png: encode_png(np.ones((52, 72), bool)), "has 52x72 pixels, height first, and"),
    ],
)
def test_score_predictions_refuses_a_damaged_png(folder, result, scene, damage, message):
    file = folder / "predictions" / mask_paths(result.rows[:1])[0]
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(InputError) as refused:
        score(folder, scene, "slgaussian")
    assert str(refused.value).startswith(str(file)) and message in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"size": [144, 104]}, "has 144x104 pixels, height first, and its view is judged at 104x"),
        ({"size": [10**9, 10**9], "counts": [10**18]}, "has 1000000000x1000000000 pixels"),
        ({"counts": "0"}, "its counts add up to 0 pixels, expected 14976; write the mask again"),
        ({"point": [3]}, "point: found [3]; "),
        ({"point": [150, 20]}, "its point is 150, 20, expected x, y in pixels of 144x104"),
        ({"point": [20, -3]}, "its point is 20, -3, expected x, y in pixels of 144x104"),
        ({"point": [0.5, 0.4]}, "in pixels of 144x104, not fractions"),
        ({"query": ""}, "query: found ''; "),
    ],
)
def test_score_predictions_refuses_an_invalid_entry(tmp_path, entries, scene, change, message):
    entries[1] |= change
    file = write(tmp_path / "own.json", entries)
    with pytest.raises(InputError) as refused:
        score(file, scene, "slgaussian")
    assert str(refused.value).startswith(f"{file}: [1]") and message in str(refused.value)


def test_read_predictions_refuses_other_documents(tmp_path, entries):
    file = tmp_path / "own.json"
    for content, message in (
        ("[", "is not valid JSON"),
        ("{}", "found no list of masks"),
        (json.dumps([entries[0]] * 2), r"\[1\], .* is there twice"),
    ):
        file.write_text(content)
        with pytest.raises(InputError, match=message):
            read_predictions(file)
    with pytest.raises(InputError, match="cannot read the file of masks"):
        read_predictions(tmp_path / "nothing")
    with pytest.raises(InputError, match="holds no mask of 3d-ovs; expected <method>/<protocol>"):
        read_predictions(tmp_path, ["3d-ovs"])
