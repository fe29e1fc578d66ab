"""Repetition of a run from ``run.toml``, and lineage of its numbers."""

import hashlib
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command import files_below, run, write_photographs
from PIL import Image
from web import receive_json

from slgaussian import datasets
from tests.language.small_clip import save_clip

FILE = "run.toml"

TIMES = {"html": '<section class="" id="times">', "md": "## Speed and accuracy"}
"""Beginning of the section of a report that differs between runs."""


@pytest.fixture(scope="module")
def first(tmp_path_factory, server):
    """Score a labelled pair, with weights and a sweep that reads another photograph."""
    folder = tmp_path_factory.mktemp("there")
    scene = datasets.load("procedural", seed=1, objects=4, views=5, height=64, width=64)
    views = {f"{name}.png": scene.read(name) for name in scene.cameras}
    write_photographs(folder / "set", views)
    target = views["view_02.png"]
    number = max(scene.phrases, key=lambda i: (target.instances == i).sum())
    rows, columns = np.nonzero(target.instances == number)
    x0, y0, x1, y1 = map(int, (columns.min(), rows.min(), columns.max(), rows.max()))
    polygon = {"category": "red ball", "segmentation": [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]}
    info = {"name": target.name, "width": 64, "height": 64}
    label = {"info": info, "objects": [{**polygon, "bbox": [x0, y0, x1, y1]}]}
    (folder / "labels").mkdir()
    (folder / "labels/view_02.json").write_text(json.dumps(label))
    entry = {"context": ["view_00.png", "view_04.png"], "target": ["view_02.png"]}
    index = {"desk": {**entry, "categories": ["red ball", "blue box"]}}
    (folder / "pairs.json").write_text(json.dumps(index))
    save_clip(folder / "clip")
    words = ["benchmark", "--data", folder / "set", "--pairs", folder / "pairs.json"]
    words += ["--labels", folder / "labels", "--size", "64x64", "--against", "no-bank"]
    words += ["--sweep", "views=3", "--set", "encoder=clip", "--set", "near=0.8"]
    words += ["--set", f"clip.model={folder / 'clip'}", "--set", "replicas=1", "--set", "far=12"]
    with pytest.MonkeyPatch.context() as patch:
        out = ["-o", folder / "report", "--store", folder / "store"]
        assert run(patch, *words, *out) == 0
    return folder


@pytest.fixture
def move_run(first, tmp_path, monkeypatch) -> Path:
    """Copy the data and ``run.toml`` alone to another place, and go to its folder."""
    for name in ("set", "labels", "clip"):
        shutil.copytree(first / name, tmp_path / name)
    (tmp_path / "report").mkdir()
    shutil.copy(first / "report" / FILE, tmp_path / "report")
    monkeypatch.chdir(tmp_path / "report")
    return tmp_path


AGAIN = ("run", FILE, "-o", "../again", "--store", "../other")


def test_a_run_repeated_elsewhere_from_its_file_alone_gives_the_same_bytes(first, move_run, slg):
    file = move_run / "report" / FILE
    versions = tomllib.loads(file.read_text())["inputs"]["software"]
    file.write_text(file.read_text().replace(f'"{versions["numpy"]}"', '"1.0"'))
    status, _, errors = slg(*AGAIN)
    assert status == 0
    # Weights; photographs, their JSON, labels and cameras: the sweep adds a photograph.
    assert f"{1 + (3 + 3) + (4 + 3)} digests are those of run.toml" in errors
    assert f"may differ, with numpy {versions['numpy']} instead of 1.0" in errors
    before, after = (
        files_below(folder, ("times",)) for folder in (first / "report", move_run / "again")
    )
    assert before.pop("pairs.json")  # the scenes of the index are in run.toml
    assert before.keys() == after.keys()
    for form, begins in TIMES.items():
        name = f"report.{form}"
        old, new = (files.pop(name).decode().split(begins) for files in (before, after))
        assert len(old) == 2 and "Repeat this" in old[0] and str(first) not in old[0]
        if form == "md":
            assert old[0] == new[0]
        else:
            assert old[0].split("<nav>")[1] == new[0].split("<nav>")[1]
    ours, theirs = (json.loads(files.pop("fields/desk/field.json")) for files in (before, after))
    assert ours.pop("places") != theirs.pop("places")
    assert ours == theirs
    assert before.pop(FILE) == after.pop(FILE)
    assert before == after


@pytest.mark.parametrize("name", ["set/view_04.png", "labels/view_02.json", "clip/config.json"])
def test_a_changed_file_is_refused_by_name_and_nothing_is_written(name, move_run, refusal):
    place = move_run / name
    if place.suffix == ".png":
        pixels = np.asarray(Image.open(place)).copy()
        pixels[0, 0] ^= 1
        Image.fromarray(pixels).save(place)
    else:
        place.write_text(place.read_text() + "\n")
    message = refusal(*AGAIN)
    assert {"set": "photograph view_04.png", "labels": "label file view_02.json",
            "clip": "clip.model"}[name.split("/")[0]] in message  # fmt: skip
    assert "found digest" in message and "delete the tables [inputs] from run.toml" in message
    assert not (move_run / "again").exists()


def sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def test_a_number_leads_back_to_photographs_labels_and_weights(first, slg, refusal):
    words = ("inspect", first / "report/report.html", "--of")
    _, out, _ = slg(*words, "desk/red ball", "--json")
    traced = json.loads(out)
    assert {row["query"] for row in traced["numbers"]} == {"red ball"}
    assert {row["method"] for row in traced["numbers"]} == {
        "slgaussian", "no-bank", "slgaussian, views=3",
    }  # fmt: skip
    made = {row["digest"] for row in traced["artifacts"]}
    needed = {d for row in traced["artifacts"] for d in row["inputs"].values()}
    assert needed < made
    stages = {row["stage"] for row in traced["artifacts"] if row["method"] == "slgaussian"}
    assert stages == {"ingest", "truth", "geometry", "masks", "supervision", "field", "benchmark"}
    files = {(file["kind"], file["name"]): file["digest"] for file in traced["files"]}
    weights = files.pop(("weights", "clip.model"))
    assert (
        weights
        == tomllib.loads((first / "report/run.toml").read_text())["inputs"]["weights"]["clip.model"]
    )
    expected = {("labels", "view_02.json"): sha256(first / "labels/view_02.json")}
    for _, name in files.keys() - expected.keys():
        expected["photographs", name] = sha256(first / "set" / name)
    assert files == expected and len(files) == 4 + 2
    _, text, _ = slg(*words, "desk/red ball")
    assert f"{sha256(first / 'set/view_00.png')}  photographs  view_00.png" in text
    assert "did you mean 'desk/red ball'" in refusal(*words, "desk/red bal")


def test_openlineage_events_of_a_run_are_complete(first, slg, tmp_path):
    client = pytest.importorskip("openlineage.client.event_v2")
    status, _, _ = slg("inspect", first / "report", "--openlineage", tmp_path / "events.ndjson")
    assert status == 0
    lines = (tmp_path / "events.ndjson").read_text().splitlines()
    known, jobs, started = set(), set(), set()
    for event in map(json.loads, lines):
        run_of, job = client.Run(**event.pop("run")), client.Job(**event.pop("job"))
        state = client.RunState(event.pop("eventType"))
        rest = {name: event.pop(name) for name in ("eventTime", "producer")}
        assert event.pop("schemaURL").endswith("RunEvent")
        parsed = client.RunEvent(
            run=run_of, job=job, eventType=state, **rest,
            inputs=[client.InputDataset(**one) for one in event.pop("inputs")],
            outputs=[client.OutputDataset(**one) for one in event.pop("outputs")],
        )  # fmt: skip
        assert event == {}
        assert (state == client.RunState.COMPLETE) == (run_of.runId in started)
        started.add(run_of.runId)
        jobs.add(parsed.job.name)
        for one in parsed.inputs:
            assert one.name in known or one.name.endswith((".png", ".json"))
            assert len(one.facets["version"]["datasetVersion"]) == 64
        known |= {one.name for one in parsed.outputs}
    assert {"ingest", "field", "benchmark", "baselines"} <= jobs
    assert "desk/slgaussian, views=3/benchmark" in known

    with receive_json() as (url, received):
        assert slg("inspect", first / "report", "--openlineage", url)[0] == 0
    sent = [received.get_nowait()["run"]["runId"] for _ in lines]
    assert received.empty() and sent == [json.loads(line)["run"]["runId"] for line in lines]
