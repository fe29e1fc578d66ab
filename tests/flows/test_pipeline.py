"""The real pipeline on a small procedural room and a scene that cannot be read."""

import json
import os
import re
import shlex
import tomllib
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command import files_below, run, score
from tiny_clusters import dask_cluster

from flows.read_config import make_settings
from flows.scene import STAGES
from slgaussian import datasets
from slgaussian.benchmark.external_predictions import SCORABLE
from slgaussian.build import build_field
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.storage import inspection
from slgaussian.storage.encoding import read_metadata
from slgaussian.storage.records import Records
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore
from tasks.benchmark import benchmark
from tests.json_documents import read_document

pytestmark = pytest.mark.usefixtures("server")

CONFIG = """
size = "64x96"
[[scenes]]
name = "room"
format = "procedural"
options = {seed = 1, objects = 4, views = 3}
context = ["view_00", "view_02"]
targets = ["view_01"]
queries = ["red ball"]
"""
(ROOM,) = tomllib.loads(CONFIG)["scenes"]


def settings_for(folder: Path, missing: Path, **more):
    bad = {"name": "lost", "path": missing, "context": ["a.png", "b.png"]}
    values = {"size": "64x96", "out": folder / "out", "scenes": [ROOM, bad], **more}
    values.setdefault("against", ["no-bank"])
    return make_settings(values, "test")


@pytest.fixture(scope="module")
def first(tmp_path_factory, server):
    folder = tmp_path_factory.mktemp("first")
    store = ArtifactStore(folder / "store")
    missing = folder.parent / "nowhere"
    finished = score(settings_for(folder, missing), store)
    return folder, missing, finished


def test_run_names_the_bad_scene_and_reports_the_good_one(first):
    folder, _, finished = first
    assert [(result.scene, result.method) for result in finished.results] == [
        ("room", "slgaussian"),
        ("room", "no-bank"),
    ]
    (row,) = pq.read_table(folder / "out" / "failures.parquet").to_pylist()
    assert (row["scene"], row["stage"], row["kind"]) == ("lost", "ingest", "InputError")
    assert "nowhere" in row["reason"]
    page = (folder / "out" / "report.html").read_text("utf-8")
    assert "lost" in page
    assert row["reason"].split(":")[0] in page
    samples = pq.read_table(folder / "out" / "samples.parquet")
    masks = pq.read_table(folder / "out" / "masks.parquet")
    assert set(masks["scene"].to_pylist()) == {"room"}
    assert set(samples["method"].to_pylist()) == {"slgaussian", "no-bank"}
    scorable = [
        name for name in samples["protocol"].to_pylist() if name.partition("@")[0] in SCORABLE
    ]
    assert len(masks) == len(scorable) > 0
    assert set(samples["frame"].to_pylist()) == {"view_01", "halfway"}
    scored = {row["query"]: row for row in samples.to_pylist() if row["iou"] is not None}
    lost = pq.read_table(folder / "out" / "attribution.parquet").to_pylist()
    assert {row["query"] for row in lost} == scored.keys()
    assert all(bool(row["lost"]) == (row["iou"] < 0.5 or not row["hit"]) for row in lost)


def test_a_second_run_is_cached_and_leaves_the_same_files(first, capsys):
    folder, missing, _ = first
    before = files_below(folder / "out", ("log",))
    score(settings_for(folder, missing), ArtifactStore(folder / "store"))
    assert files_below(folder / "out", ("log",)) == before
    printed = capsys.readouterr().err
    assert "room  8 stages cached" in printed
    assert not re.search(r"\w [\d.]+ s( ·|\n)", printed.split("left out at")[1].split("\n", 1)[1])


@pytest.mark.parametrize("kind", ["processes", "dask"])
def test_every_runner_leaves_the_same_files(kind, first, tmp_path, request):
    folder, missing, _ = first
    store, runner = ArtifactStore(tmp_path / "store"), kind
    with ExitStack() as stack:
        if kind == "dask":
            pytest.importorskip("prefect_dask")
            store = ArtifactStore(f"{request.getfixturevalue('bucket')}/slg")
            runner = stack.enter_context(dask_cluster())
        score(settings_for(tmp_path, missing, runner=runner, workers=1), store)
    hidden = ("log", "times", "report.")
    assert files_below(tmp_path / "out", hidden) == files_below(folder / "out", hidden)


def test_every_artifact_says_which_stage_made_it(first):
    folder, _, _ = first
    store = ArtifactStore(folder / "store")
    stages = set()
    for records in Records(store).all():
        for record in records:
            metadata = read_metadata(store.read(record.ref.uri))
            assert metadata["spec"] == load_spec(record.ref.spec).label
            assert (metadata["made"]["stage"], metadata["made"]["stage_version"]) == (
                record.stage,
                record.version,
            )
            assert metadata["made"]["settings"] == record.ref.meta["settings"]
            assert metadata["made"]["of"].keys() == record.ref.meta["inputs"].keys()
            stages.add(record.stage)
    assert stages == {*(stage.name for stage in STAGES), "baselines", "report"}


def test_documents_are_what_their_specs_say(first):
    folder, _, _ = first
    out = folder / "out"
    read_document((out / "manifest.json").read_bytes(), load_spec("manifest"), "m")
    times = read_document((out / "times.json").read_bytes(), load_spec("run_times"), "t")
    assert times["spec"] == "slgaussian/run_times@5"
    field = out / "fields" / "room" / "field.json"
    read_document(field.read_bytes(), load_spec("field_json"), "f")
    files = list(inspection.inspect(out))
    assert [file["problem"] for file in files if file["problem"]] == []
    assert {Path(file["path"]).name for file in files} >= {
        "manifest.json",
        "times.json",
        "field.json",
    }


def test_each_scene_leaves_its_field_as_the_command_field_builds_it(first, tmp_path, monkeypatch):
    folder, missing, finished = first
    left = folder / "out" / "fields" / "room"
    (row,) = pq.read_table(folder / "out" / "fields.parquet").to_pylist()
    field = SemanticField.load(left)
    assert row["folder"] == "room" and row["gaussians"] == len(field.gaussians)
    settings = settings_for(folder, missing)
    scene = datasets.load(ROOM["format"], **ROOM["options"])
    sample = scene.sample(ROOM["context"], size=settings.size)
    expected = build_field(replace(sample, scene="room"), settings.field_method)
    expected.save(tmp_path / "own")
    for file in left.iterdir():
        data, mine = file.read_bytes(), (tmp_path / "own" / file.name).read_bytes()
        if file.suffix == ".json":  # which has the digests of what the others hold
            assert data == mine
            continue
        origin, expected_origin = ({**read_metadata(content)["made"]} for content in (data, mine))
        stage = "supervision" if file.name == "bank.npz" else "field"
        assert (origin["stage"], expected_origin["stage"]) == (stage, "build_field")
        assert origin["software"] == expected_origin["software"]
    assert finished.ready.startswith("slgaussian query ")
    assert shlex.split(finished.look) == ["slgaussian", "view", str(left)]


def test_the_last_line_of_a_run_is_a_command_that_works(first, tmp_path, monkeypatch, capsys):
    folder, _, _ = first
    config = tmp_path / "run.toml"
    config.write_text(CONFIG)
    monkeypatch.chdir(tmp_path)
    words = ["run", config, "--store", folder / "store", "-o", "out of it's reach"]
    assert run(monkeypatch, *words) == 0
    printed = capsys.readouterr()
    assert "room  benchmark  cached" in printed.err
    words = shlex.split(printed.out.splitlines()[-1])
    assert words[:3] == ["slgaussian", "query", "out of it's reach/fields/room"]
    assert run(monkeypatch, *words[1:], "--json") == 0
    (answer,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert answer["text"] == words[3] and answer["pixels"] > 0 and answer["score"] > 0.5
    assert (tmp_path / words[-1]).read_bytes()[:4] == b"\x89PNG"
    # It is asked what the truth says is answered rightly.
    rows = pq.read_table("out of it's reach/samples.parquet").to_pylist()
    ious = [row["iou"] for row in rows if row["query"] == words[3] and row["iou"] is not None]
    assert ious and min(ious) > 0.5


def test_a_scene_that_fails_later_leaves_its_field_and_one_that_is_gone_none(
    first, tmp_path, monkeypatch
):
    folder, missing, _ = first
    store = ArtifactStore(folder / "store")

    def break_down(*_: object) -> None:
        raise InputError("no answer")

    settings = settings_for(tmp_path, missing, against=[], share=0.5)
    with monkeypatch.context() as broken:
        broken.setattr(benchmark, "compute", break_down)
        finished = score(settings, store)
    assert [(f.scene, f.stage) for f in finished.failures] == [
        ("lost", "ingest"),
        ("room", "benchmark"),
    ]
    left = tmp_path / "out" / "fields" / "room"
    assert files_below(left) == files_below(folder / "out" / "fields" / "room")
    words = shlex.split(finished.ready)
    assert words[:3] == ["slgaussian", "render", str(left)]
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *words[1:]) == 0
    only_lost = [scene for scene in settings.scenes if scene.name == "lost"]
    finished = score(settings.model_copy(update={"scenes": only_lost}), store)
    assert finished.ready == "" and not left.exists()
    assert pq.read_table(tmp_path / "out" / "fields.parquet").num_rows == 0


def test_a_query_setting_recomputes_the_benchmark_alone(first, capsys):
    folder, missing, _ = first
    score(settings_for(folder, missing, temperature=5.0), ArtifactStore(folder / "store"))
    line = next(n for n in capsys.readouterr().err.splitlines() if n.startswith("room"))
    assert line.startswith("room  benchmark ")
    assert line.endswith("6 stages cached")


# The last test of the file: it leaves the run that the others look at harmed.
def test_run_computes_damaged_artifacts_again(first, monkeypatch):
    """All artifacts are damaged at once: fields link to some, reports use others."""
    folder, missing, _ = first
    hidden = ("log", "times", "report.")  # they say when, or how fast
    store = ArtifactStore(folder / "store")
    settings = settings_for(folder, missing, store=store.root)
    score(settings, store)
    before = files_below(folder / "out", hidden)
    # Other tests leave artifacts of other configurations in this store: no run makes those again.
    used = []
    with monkeypatch.context() as patch:
        find = Records.find
        patch.setattr(Records, "find", lambda *key: used.append(find(*key)) or used[-1])
        score(settings, store)
    artifacts = {uri: Path(store.path, uri).read_bytes() for ref in used for uri in ref.uris}
    for number, (name, data) in enumerate(artifacts.items()):
        file = Path(store.path, name)
        stamp = file.stat().st_mtime_ns
        half = len(data) // 2
        flipped = data[:half] + bytes([data[half] ^ 255]) + data[half + 1 :]
        file.write_bytes((b"", data[:half], flipped)[number % 3])
        os.utime(file, ns=(stamp, stamp))  # a disk that forgets leaves the time as it is
    assert files_below(folder / "out", hidden) != before
    score(settings, store)
    assert files_below(folder / "out", hidden) == before
    harmed = {name for name in artifacts if name.split("/")[0] in HANDED_OUT}
    assert {name.split("/")[0] for name in harmed} == HANDED_OUT
    assert all(Path(store.path, name).stat().st_size for name in harmed)
    # By content: bytes name the run that wrote them, which may be another one of equal content.
    damaged = {row["path"] for row in inspection.inspect(Path(store.path)) if row["problem"]}
    assert not {f"{store.path}/{name}" for name in harmed} & damaged


HANDED_OUT = {"attribution", "bank", "field", "gaussians", "objects", "report", "scene_result"}
