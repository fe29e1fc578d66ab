"""Fields in the output of runs: links to the store's files, one folder for each scene."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command import room_sample

from flows import results
from slgaussian.benchmark.evaluate import SceneResult
from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.language import COMMON_OBJECTS
from slgaussian.storage.housekeeping import collect
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore, DamagedError
from tasks.artifacts import about_field, put_field
from tasks.benchmark import example

SCENES = {"room": "room", "a room/of *mine*": "a room_of _mine_-"}
"""Scenes, and how the names of their folders begin."""


@pytest.fixture(scope="module")
def field() -> SemanticField:
    return build_field(room_sample(), Method(replicas=1))


def here(tmp_path: Path) -> str:
    return str(tmp_path / "store")


@pytest.fixture(params=["folder", "bucket"])
def store(request, tmp_path) -> ArtifactStore:
    """Stores whose files can and cannot be linked."""
    if request.param == "bucket":
        return ArtifactStore(f"{request.getfixturevalue('bucket')}/slg")
    return ArtifactStore(here(tmp_path))


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """Return the inode and modification time of each file."""
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(f.relative_to(folder)): (f.stat().st_ino, f.stat().st_mtime_ns) for f in files}


def test_write_fields_equals_save(field, store, tmp_path):
    ref, out = put_field(store, field), tmp_path / "out"
    results.write_fields(store, dict.fromkeys(SCENES, ref), {}, out)
    field.save(tmp_path / "saved")
    rows = pq.read_table(out / "fields.parquet").to_pylist()
    assert [row["scene"] for row in rows] == list(SCENES)
    for row, begins in zip(rows, SCENES.values(), strict=True):
        assert row["folder"].startswith(begins)
        assert (row["gaussians"], row["objects"]) == (len(field.gaussians), len(field.bank))
        folder = out / "fields" / row["folder"]
        assert folder == results.field_place(row["scene"], out)
        assert sorted(os.listdir(folder)) == sorted(os.listdir(tmp_path / "saved"))
        for file in folder.iterdir():
            assert file.read_bytes() == (tmp_path / "saved" / file.name).read_bytes()
    (camera, *_) = field.cameras.values()
    hit = SemanticField.load(folder).render(camera).query("wall")
    assert hit.objects == field.render(camera).query("wall").objects != ()


def test_write_fields_repairs_differing_files_only(field, store, tmp_path):
    fields, out = dict.fromkeys(SCENES, put_field(store, field)), tmp_path / "out"

    def rewrite(places=None) -> set[str]:
        """Write the fields again; return the files that were replaced."""
        before = stamps(out / "fields")
        results.write_fields(store, fields, places or {}, out)
        after = stamps(out / "fields")
        assert before.keys() <= after.keys()
        return {name for name in after if after[name] != before.get(name)}

    results.write_fields(store, fields, {}, out)
    assert rewrite() == set()
    room = out / "fields" / "room"
    (room / "bank.npz").unlink()
    assert {"room/bank.npz"} <= rewrite() <= {f"room/{name}" for name in os.listdir(room)}
    (room / "field.json").write_text("{}")
    assert "room/field.json" in rewrite()
    assert len(rewrite({"model": "/moved"})) >= len(SCENES)
    assert json.loads((room / "field.json").read_text())["places"] == {"model": "/moved"}
    assert rewrite({"model": "/moved"}) == set()


def test_write_fields_survive_a_cleared_store(field, store, tmp_path):
    out = tmp_path / "out"
    ref = put_field(store, field)
    key = f"field/v3/{'0' * 64}"
    Records(store).keep(key, ref)
    results.write_fields(store, {"room": ref}, {}, out)
    assert collect(store, -60, {"field": 3}, delete=True).kept == 4
    store.remove([f"keys/field/v3/00/{'0' * 64}.json"])
    assert collect(store, -60, {"field": 3}, delete=True).artifacts == 4
    assert repr(SemanticField.load(out / "fields" / "room")) == repr(field)
    with pytest.raises(DamagedError, match="found nothing"):
        results.write_fields(store, {"room": ref}, {}, out)


def test_write_fields_removes_fields_of_an_earlier_run_only(field, tmp_path):
    store, out = ArtifactStore(here(tmp_path)), tmp_path / "out"
    ref = put_field(store, field)
    results.write_fields(store, dict.fromkeys([*SCENES, "third"], ref), {}, out)
    field.save(out / "fields" / "mine")
    results.write_fields(store, {"third": ref}, {}, out)
    assert sorted(os.listdir(out / "fields")) == ["mine", "third"]
    assert pq.read_table(out / "fields.parquet")["folder"].to_pylist() == ["third"]
    # A table that says otherwise leads nowhere else.
    elsewhere = tmp_path / "elsewhere"
    field.save(elsewhere)
    table = pq.read_table(out / "fields.parquet")
    named = table.set_column(1, "folder", [["../../elsewhere"]])
    pq.write_table(named, out / "fields.parquet")
    results.write_fields(store, {"third": ref}, {}, out)
    assert elsewhere.is_dir()
    results.write_fields(store, {}, {}, out)
    assert sorted(os.listdir(out / "fields")) == ["mine"]
    (out / "fields.parquet").write_bytes(b"no table")
    results.write_fields(store, {"third": ref}, {}, out)
    assert sorted(os.listdir(out / "fields")) == ["mine", "third"]


def test_write_fields_links_files_of_the_store(field, tmp_path):
    store, out = ArtifactStore(here(tmp_path)), tmp_path / "out"
    ref = put_field(store, field)
    results.write_fields(store, {"room": ref}, {}, out)
    _, parts = about_field(store, ref)
    file, local = out / "fields/room/gaussians.npz", Path(store.path, parts["gaussians"].uri)
    assert os.path.samefile(file, local)
    shutil.rmtree(store.path)
    changed = replace(field, settings={**field.settings, "scene": "other"})
    changed.save(file.parent)
    assert SemanticField.load(file.parent).settings["scene"] == "other"


def row(query: str, frame: str = "a", iou: float | None = 0.9, hit: bool = True, **local) -> dict:
    inputs = {"query": query, "frame": frame, "iou": iou, "hit_mask": hit, "score": 0.6, "note": ""}
    return {**inputs, "protocol": "slgaussian@2", **local}


def example_text(field: SemanticField, *rows: dict) -> str | None:
    result = example(SceneResult("room", list(rows), {}, {}, {}), field)
    return None if result is None else result["text"]


def test_example_is_a_query_with_a_correct_answer(field):
    first, *_ = field.cameras.values()
    texts = [*COMMON_OBJECTS, "blue wall", "grey floor", "ball", "cone"]
    hits = field.render(first).query_all(texts)
    item, two, *_ = (hit.text for hit in hits if hit.found)
    unsure = next(hit.text for hit in hits if hit.objects and not hit.found)
    assert example_text(field, row(item, iou=0.8), row(two)) == two
    assert example_text(field, row(item, iou=0.8), row(two, hit=False)) == item
    assert example_text(field, row(item, iou=0.6), row(two), row(two, "b", 0.4)) == item
    assert example_text(field, row(item, iou=0.8), row(two, protocol="langsplat@2")) == item
    # What was asked without truth comes after all that is known to be right.
    unknown = {"iou": None, "hit": None}
    assert example_text(field, row(item, **unknown, score=0.9), row(two, iou=0.6)) == two
    assert example_text(field, row(item, **unknown), row(two, **unknown, score=0.7)) == two
    assert example_text(field, row(item, iou=0.3), row(two, note="unknown: x")) is None
    assert example_text(field) is None
    # However right the truth says it is, what the field does not call found is not proposed.
    assert example_text(field, row(item, iou=0.6), row(unsure, iou=0.9)) == item
    assert example_text(field, row(unsure, iou=0.9)) is None
