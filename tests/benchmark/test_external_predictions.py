"""Masks that were made elsewhere: scored as a run scores its own, or refused in one sentence."""

import json
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
from slgaussian.benchmark.outputs import mask_path, write_predictions
from slgaussian.benchmark.pictures import encode_png
from slgaussian.benchmark.protocols import load_protocol
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from tests.run_lengths import encode

OF_MASKS = ("iou", "boundary_iou", "class_iou", "accuracy")
OF_POINTS = ("hit_mask", "hit_box")


@pytest.fixture(scope="module")
def judged(room, result):
    """What the rooms' fixture asked, but for the text that was asked without truth."""
    masks = room.truth["view_01"]
    some = next(iter(masks.values()))
    asked = masks | {"qqwx": some, "red sofa": np.zeros_like(some)}
    return JudgedScene(result.scene, result.dataset, "a place", Truth({"view_01": asked}))


@pytest.fixture
def folder(tmp_path, result):
    """What a benchmark leaves of it."""
    masks = {key: encode_png(mask) for key, mask in result.predictions.items()}
    write_predictions(result.rows, masks, tmp_path / "run" / "predictions")
    return tmp_path / "run"


def place_of(result, folder, query, protocol="slgaussian@2"):
    row = {**result.rows[0], "query": query, "protocol": protocol}
    return folder / "predictions" / mask_path(row)


def scored(place, judged, *protocols):
    predictions = read_predictions(place, protocols)
    chosen = [load_protocol(name) for name in protocols or predictions.protocols]
    return list(score_predictions(predictions, [judged], chosen)), predictions


def by_key(rows):
    return {(row["protocol"], row["frame"], row["query"]): row for row in rows}


def as_file(path, result, protocol="slgaussian@2", text=True, **more):
    """The masks of a protocol as a JSON file, with all that may be there."""
    entries = []
    for row in result.rows:
        mask = result.predictions.get((protocol, row["frame"], row["query"]))
        if row["protocol"] == protocol and mask is not None and row["frame"] == "view_01":
            counts = encode(mask)
            entry = {name: row[name] for name in ("scene", "frame", "query")}
            if row["point_x"] is not None:
                entry["point"] = [row["point_x"], row["point_y"]]
            if not text:
                flat = mask.ravel(order="F")
                starts = np.flatnonzero(np.diff(flat, prepend=False))
                counts = np.diff(starts, prepend=0, append=flat.size).tolist()
            entries.append({**entry, "size": list(mask.shape), "counts": counts, **more})
    path.write_text(json.dumps(entries))
    return path


def test_masks_of_a_run_have_the_scores_of_the_run(folder, result, judged):
    (again,), predictions = scored(folder, judged)
    assert predictions.methods == {"slgaussian": tuple(sorted(SCORABLE))}
    theirs = by_key(result.rows)
    for key, row in by_key(again.rows).items():
        assert list(row) == list(load_spec("samples").columns)
        for name in (*OF_MASKS, "height", "width"):
            assert row[name] == theirs[key][name], (key, name)
        # What masks do not say is not said.
        assert row["score"] is row["point_x"] is row["hit_mask"] is row["hit_peak"] is None
        assert row["selection"] == "given" and row["temperature"] is None
    known = {key for key in theirs if key[1] == "view_01" and key[0].partition("@")[0] in SCORABLE}
    assert by_key(again.rows).keys() == known
    assert any(row["accuracy"] for row in again.rows) and any(r["class_iou"] for r in again.rows)
    assert by_key(again.rows)["slgaussian@2", "view_01", "red sofa"]["note"] == ABSENT
    assert predictions.missing == []
    unused = predictions.unused
    assert unused and all(" in halfway of " in name for name in unused)
    for key, mask in again.predictions.items():
        assert np.array_equal(mask, result.predictions[key])


@pytest.mark.parametrize("text", [True, False])
def test_run_lengths_with_points_have_the_hits_of_the_run_too(tmp_path, result, judged, text):
    place = as_file(tmp_path / "mine.json", result, text=text)
    (again,), predictions = scored(place, judged, "slgaussian")
    theirs = by_key(result.rows)
    assert again.method == "mine" and predictions.methods == {"mine": ()}
    rows = by_key(again.rows)
    assert len(rows) == len(judged.truth.masks["view_01"])
    for key, row in rows.items():
        names = ("iou", "boundary_iou", "point_x", "point_y")
        assert [row[name] for name in names] == [theirs[key][name] for name in names]
        if row["point_x"] is not None:  # a text that is not understood has none
            assert [row[n] for n in OF_POINTS] == [theirs[key][n] for n in OF_POINTS]
        assert row["class_iou"] is None
    assert any(row["hit_mask"] for row in rows.values())
    box = by_key(scored(place, judged, "langsplat")[0][0].rows)["langsplat@2", "view_01", "qqwx"]
    assert box["hit_box"] is None and box["iou"] == 0


def test_texts_that_compete_say_which_wins_by_both_protocols(tmp_path, result, judged):
    place = as_file(tmp_path / "own.json", result, "3d-ovs@2", method="ours")
    (again,), _ = scored(place, judged, "slgaussian", "3d-ovs")
    theirs = by_key(result.rows)
    for (protocol, *rest), row in by_key(again.rows).items():
        assert row["class_iou"] == theirs["slgaussian@2", *rest]["class_iou"]
        if protocol == "3d-ovs@2":
            assert row["accuracy"] == theirs[protocol, *rest]["accuracy"] > 0
    assert again.method == "ours"


def test_masks_that_overlap_do_not_compete(tmp_path, result, judged):
    entries = json.loads(as_file(tmp_path / "own.json", result, "3d-ovs@2").read_text())
    whole = np.ones(result.predictions["slgaussian@2", "view_01", "qqwx"].shape, bool)
    entries[-1]["counts"] = encode(whole)
    (tmp_path / "own.json").write_text(json.dumps(entries))
    with pytest.raises(InputError, match=r"own\.json: \[\d+\], .* overlaps the mask of '"):
        scored(tmp_path / "own.json", judged, "3d-ovs")
    assert scored(tmp_path / "own.json", judged, "slgaussian")


def test_a_mask_that_is_missing_is_an_empty_one_and_counted(folder, result, judged):
    query = next(q for q, mask in judged.truth.masks["view_01"].items() if mask.any())
    place_of(result, folder, query).unlink()
    place_of(result, folder, "red sofa").unlink()  # no truth: no sample
    (again,), predictions = scored(folder, judged, "slgaussian")
    rows = by_key(again.rows)
    row = rows["slgaussian@2", "view_01", query]
    assert (row["iou"], row["note"]) == (0, NOT_GIVEN)
    assert rows["slgaussian@2", "view_01", "red sofa"]["note"] == ABSENT
    samples = sum(mask.any() for mask in judged.truth.masks["view_01"].values())
    assert predictions.samples == samples
    assert predictions.missing == [f"{query!r} in view_01 of {judged.scene}"]
    assert ("slgaussian@2", "view_01", query) not in again.predictions


def test_names_may_be_plain_and_frames_without_folder_and_ending(folder, tmp_path, judged):
    masks = judged.truth.masks["view_01"]
    query, other = (text for text, mask in list(masks.items())[:2])
    odd = Truth({"left/view_01.jpg": {"café": masks[query], "a?b": masks[other]}})
    own = replace(judged, scene="Zuhause, oben", truth=odd)
    target = tmp_path / "p" / "My method!" / "slgaussian" / own.scene / "view_01"
    target.mkdir(parents=True)
    Image.fromarray(masks[query]).save(target / "café.png")
    row = {"method": "My method!", "protocol": "slgaussian@2", "scene": own.scene}
    safe = mask_path({**row, "frame": "left/view_01.jpg", "query": "a?b"})
    (tmp_path / "p" / "My method!" / safe.relative_to(safe.parts[0])).parent.mkdir(parents=True)
    Image.fromarray(masks[other]).save(
        tmp_path / "p" / "My method!" / safe.relative_to(safe.parts[0])
    )
    (again,), predictions = scored(tmp_path / "p", own)
    assert [row["iou"] for row in again.rows] == [1, 1] and not predictions.missing
    assert again.method == "My method!" and not predictions.unused
    entry = {"scene": own.scene, "frame": "view_01", "query": "café", "size": [104, 144]}
    file = tmp_path / "m.json"
    file.write_text(json.dumps([{**entry, "counts": encode(masks[query])}]))
    (again,), predictions = scored(file, own)
    assert [row["iou"] for row in again.rows] == [1, 0] and len(predictions.missing) == 1


def test_a_damaged_mask_is_one_sentence(folder, result, judged):
    query = next(iter(judged.truth.masks["view_01"]))
    file = place_of(result, folder, query)
    whole = file.read_bytes()
    for damage, said in (
        (whole[: len(whole) // 2], "is damaged or of another kind"),
        (encode_png(np.ones((52, 72), bool)), "has 52x72 pixels, height first, and its view is"),
    ):
        file.write_bytes(damage)
        with pytest.raises(InputError) as refused:
            scored(folder, judged, "slgaussian")
        assert str(refused.value).startswith(str(file)) and said in str(refused.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"size": [144, 104]}, "has 144x104 pixels, height first, and its view is judged at 104x"),
        ({"size": [10**9, 10**9], "counts": [10**18]}, "has 1000000000x1000000000 pixels"),
        ({"counts": "0"}, "its counts add up to 0 pixels, expected 14976; write the mask again"),
        ({"point": [3]}, "point: found [3]; "),
        ({"query": ""}, "query: found ''; "),
    ],
)
def test_an_entry_that_does_not_fit_is_one_sentence(tmp_path, result, judged, change, said):
    file = as_file(tmp_path / "own.json", result)
    entries = json.loads(file.read_text())
    entries[1] |= change
    file.write_text(json.dumps(entries))
    with pytest.raises(InputError) as refused:
        scored(file, judged, "slgaussian")
    assert str(refused.value).startswith(f"{file}: [1]") and said in str(refused.value)


def test_what_is_no_list_of_masks_is_one_sentence(tmp_path, result, judged):
    file = as_file(tmp_path / "own.json", result)
    entries = json.loads(file.read_text())
    for content, said in (
        ("[", "is not valid JSON"),
        ("{}", "found no list of masks"),
        (json.dumps([entries[0], entries[0]]), r"\[1\], .* is there twice"),
    ):
        file.write_text(content)
        with pytest.raises(InputError, match=said):
            read_predictions(file)
    with pytest.raises(InputError, match="cannot read the file of masks"):
        read_predictions(tmp_path / "nothing")
    with pytest.raises(InputError, match="holds no mask of 3d-ovs; expected <method>/<protocol>"):
        read_predictions(tmp_path, ["3d-ovs"])
