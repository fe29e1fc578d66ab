"""`slgaussian benchmark --views`: the same targets with several numbers of context views."""

import json

import pyarrow.parquet as pq
import pytest
from command import run, said, save_photographs

from flows import by_views
from flows.pipeline import scenes_of
from flows.room_scenes import room_scene
from flows.settings import make_settings
from slgaussian import datasets
from slgaussian.datasets import re10k
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore

pytestmark = pytest.mark.usefixtures("server")

SMALL = {"size": "64x96", "replicas": 1}


@pytest.fixture(scope="module")
def made(tmp_path_factory, server):
    """Two rooms with 2 and 3 views; a scene of two photographs cannot have three."""
    folder = tmp_path_factory.mktemp("numbers")
    photographs = save_photographs(folder)
    pair = {
        "name": "pair",
        "path": photographs,
        "context": ["view_00.png", "view_02.png"],
        "targets": ["view_00.png"],
    }
    values = {"rooms": "0-1", "views": "3,2", "scenes": [pair], "out": folder / "out", **SMALL}
    values["against"] = ["nearest-view"]
    store = ArtifactStore(folder / "store")
    settings = make_settings(values, "test")
    return folder, settings, store, by_views.run(settings, store)


def test_all_numbers_are_asked_in_the_same_targets(made):
    folder, settings, *_ = made
    assert settings.views == (2, 3)
    targets, samples = [], []
    for number in (2, 3):
        of = folder / "out" / f"views_{number}"
        data = json.loads((of / "manifest.json").read_text())["data"]
        assert all(len(scene["context"]) == number for scene in data.values())
        assert all(not set(s["context"]) & set(s["targets"]) for s in data.values())
        targets.append({name: scene["targets"] for name, scene in data.items()})
        rows = pq.read_table(of / "samples.parquet").to_pylist()
        samples.append({(r["scene"], r["frame"], r["query"]) for r in rows})
        assert (of / "report.html").is_file()
        assert {field.name for field in (of / "fields").iterdir()} == {"room_0", "room_1"}
    assert targets[0] == targets[1] and samples[0] == samples[1]


def test_the_table_has_a_row_a_scene_and_number_with_the_scores_of_their_reports(made):
    folder, *_, finished = made
    table = pq.read_table(folder / "out" / "view_counts.parquet")
    load_spec("view_counts").check_table(table, "view_counts.parquet")
    rows = table.to_pylist()
    assert [(row["scene"], row["views"]) for row in rows] == [
        ("room_0", 2), ("room_1", 2), ("room_0", 3), ("room_1", 3),
    ]  # fmt: skip
    for row in rows:
        assert len(row["context"].split(", ")) == row["views"]
        of = folder / "out" / f"views_{row['views']}"
        scores = pq.read_table(of / "samples.parquet").to_pylist()
        own = [
            score["iou"]
            for score in scores
            if score["scene"] == row["scene"]
            and score["method"] == "slgaussian"
            and score["protocol"].startswith("slgaussian@")
            and score["iou"] is not None
        ]
        assert row["iou"] == pytest.approx(sum(own) / len(own))
        assert (
            row["gaussians"] >= row["kept"] > 0 and row["psnr"] > 10 and row["target_abs_rel"] < 0.5
        )
    (counts,) = finished.counts
    assert (counts.dataset, counts.scenes) == ("procedural", 2)
    assert all(line.seconds > 0 for line in counts.lines)


def test_a_scene_of_too_few_photographs_is_left_out_and_said(made):
    folder, *_, finished = made
    (failure,) = finished.failures
    assert (failure.scene, failure.stage) == ("pair", "views")
    assert "found 2 context views" in failure.reason
    assert pq.read_table(folder / "out" / "failures.parquet")["scene"].to_pylist() == ["pair"]
    assert "found 2 context views" in finished.report.read_text()


def test_again_it_is_found_in_the_store_and_has_the_same_bytes(made):
    folder, settings, store, _ = made
    before = {
        name: (folder / "out" / name).read_bytes() for name in ("view_counts.parquet", "views.html")
    }
    again = settings.model_copy(update={"out": folder / "again"})
    by_views.run(again, store)
    assert {name: (folder / "again" / name).read_bytes() for name in before} == before


def test_the_command_prints_a_line_a_number(made, monkeypatch, capsys, tmp_path):
    folder, *_ = made
    words = ("benchmark", "--rooms", "0-1", "--views", "2,3", "--size", "64x96", "--replicas", "1")
    where = ("--store", folder / "store", "-o", tmp_path / "out")
    assert run(monkeypatch, *words, *where) == 0
    told = capsys.readouterr().out.splitlines()
    heading = next(line for line in told if line.startswith("procedural"))
    assert "PSNR" in heading and heading.endswith("Gaussians  seconds")
    assert [line[:7] for line in told[1:3]] == ["2 views", "3 views"]
    assert "means over 2 scenes" in told
    assert f"report: {tmp_path / 'out' / 'views.html'}" in told
    assert any(line.startswith("slgaussian query") and "views_3" in line for line in told)


def test_two_views_are_what_a_run_without_numbers_scores(made, tmp_path):
    folder, _, store, _ = made
    scene = room_scene(0, 3).model_dump()
    plain = make_settings({"scenes": [scene], "out": tmp_path / "plain", **SMALL}, "test")
    by_views.run(plain, store)
    assert not (tmp_path / "plain" / "views.html").exists()
    rows = pq.read_table(tmp_path / "plain" / "samples.parquet").to_pylist()
    two = pq.read_table(folder / "out" / "views_2" / "samples.parquet").to_pylist()
    own = [row for row in two if (row["scene"], row["method"]) == ("room_0", "slgaussian")]
    assert rows == own


def test_a_room_with_further_views_has_the_cameras_of_the_plain_one():
    plain, parted = room_scene(5), room_scene(5, 3)
    one, other = (datasets.load("procedural", **scene.options) for scene in (plain, parted))
    for scene_name, parted_name in zip(
        (*plain.context, *plain.targets), (*parted.context, *parted.targets), strict=True
    ):
        camera, same = one.cameras[scene_name], other.cameras[parted_name]
        assert abs(camera.c2w - same.c2w).max() < 1e-12
    assert len(other.cameras) - len(parted.targets) == 8


def chosen_of(tmp_path, index, **settings):
    """The context views by number that a run with this index would have, and its scenes."""
    (tmp_path / "index.json").write_text(json.dumps(index))
    given = {"pairs": tmp_path / "index.json", "views": [2, 3, 4], **settings}
    scenes, _ = scenes_of(make_settings(given, "test"))
    chosen, failures = by_views._with_numbers(scenes, (2, 3, 4))
    assert failures == []
    return [{number: own[number].context for number in own} for own in chosen], scenes


def test_indices_of_realestate10k_are_added_to_and_may_have_more_views(tmp_path):
    plain = datasets.load("procedural", 2, views=41, baseline=1.2, height=48, width=64)
    clip = re10k.clip_of(plain)
    re10k.write(tmp_path / "clips", [clip])
    two, four = (
        {"context": [4, 36], "target": [12, 30]},
        {"context": [0, 12, 24, 40], "target": [8]},
    )
    (own,), _ = chosen_of(tmp_path, {clip.key: two}, data=tmp_path / "clips")
    assert own[2] == ["4", "36"] and own[3] == ["4", "36", "20"]
    assert own[4][:3] == own[3] and not {"12", "30"} & set(own[4])
    (own,), _ = chosen_of(tmp_path, {clip.key: four}, data=tmp_path / "clips")
    assert own == {2: ["0", "40"], 3: ["0", "24", "40"], 4: ["0", "12", "24", "40"]}


def test_indices_of_llff_are_added_to_and_need_no_labels(real_data, tmp_path):
    names = [f"image{k:03}.png" for k in range(20)]
    fern = {"context": names[1:6:2], "target": names[::8]}
    index = {"version": 2, "format": "llff", "rule": {}, "left_out": {}, "scenes": {"fern": fern}}
    (own,), (scene,) = chosen_of(tmp_path, index, data=real_data / "fern")
    assert (scene.format, scene.labels, scene.categories) == ("llff", None, [])
    assert own[2] == [names[1], names[5]] and own[3] == names[1:6:2]
    assert own[4][:3] == own[3] and not set(own[4]) & set(fern["target"])


@pytest.mark.parametrize("views", ["1,2", "2,2", "two", "", "2,,3"])
def test_numbers_that_are_none_are_one_sentence(views, monkeypatch, capsys, tmp_path):
    words = ("benchmark", "--rooms", "0", "--views", views, "-o", tmp_path / "out")
    assert run(monkeypatch, *words) == 2
    assert "views: found" in said(capsys)


def test_nothing_is_worked_on_if_no_scene_has_so_many(tmp_path):
    values = {"rooms": "0", "views": "2,40", "out": tmp_path / "out", **SMALL}
    with pytest.raises(InputError, match=r"no scene has 40 context views .* found 8 context views"):
        by_views.run(make_settings(values, "test"), ArtifactStore(tmp_path / "store"))
    assert not (tmp_path / "out" / "views_2").exists()
