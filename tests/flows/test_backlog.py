"""Results that a configuration lacks in its store: listed, and computed alone."""

import json
import re
from pathlib import Path

import pytest
from command import files_below

from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore
from tasks.scene import geometry

pytestmark = pytest.mark.usefixtures("server")

CONFIG = """
size = "64x96"
workers = 1
store = "store"
out = "out"
against = ["no-bank"]
[[scenes]]
name = "kitchen"
path = "nowhere"
context = ["a.png", "b.png"]
"""
SCENE = """
[[scenes]]
name = "room_{0}"
format = "procedural"
options = {{seed = {0}, objects = 4, views = 3}}
context = ["view_00", "view_02"]
targets = ["view_01"]
"""


@pytest.fixture
def status(slg):
    """List the backlog of a configuration; return the exit status and the JSON."""

    def call(config):
        code, out, _ = slg("store", "status", config, "--json")
        return code, json.loads(out)

    return call


def find_record(store: ArtifactStore, stage: str, seed: int) -> Path:
    """Return the record of a stage of a room, followed from its photographs."""
    records = [r for batch in Records(store).all() for r in batch if r.ref is not None]
    options = {"seed": seed, "objects": 4, "views": 3}
    (sample,) = (
        r.ref.digest
        for r in records
        if r.ref.meta["settings"].get("photographs", {}).get("options") == options
    )
    (file,) = (
        r.file for r in records if r.stage == stage and sample in r.ref.meta["inputs"].values()
    )
    return Path(store.path, file.uri)


def test_status_lists_missing_results_and_only_missing_computes_them(slg, status, tmp_path):
    """Of two rooms and a scene that cannot be read, results are lost and outdated in turn."""
    config, store = tmp_path / "rooms.toml", ArtifactStore(tmp_path / "store")
    config.write_text(CONFIG + SCENE.format(1) + SCENE.format(2))
    code, _, errors = slg("store", "status", config)
    assert code == 2 and "found no folder, expected a store" in errors
    assert slg("run", config)[0] == 1
    first = files_below(tmp_path / "out", ("times", "report"))
    code, backlog = status(config)
    (kitchen,) = backlog["gaps"]
    assert code == 1 and (backlog["complete"], backlog["total"]) == (4, 5)
    assert (kitchen["scene"], kitchen["stage"], kitchen["state"]) == ("kitchen", "ingest", "failed")
    assert "nowhere" in kitchen["reason"]

    record = find_record(store, "geometry", 1)
    seconds = json.loads(find_record(store, "geometry", 2).read_text())["meta"]["seconds"]
    older = Path(str(record).replace(f"/v{geometry.version}/", f"/v{geometry.version - 1}/"))
    older.parent.mkdir(parents=True)
    record.rename(older)
    find_record(store, "benchmark", 2).unlink()
    before = files_below(tmp_path / "store", (".prefect",))
    code, backlog = status(config)
    stages, gaps = backlog["stages"], {gap["scene"]: gap for gap in backlog["gaps"]}
    assert {scene: (g["stage"], g["state"]) for scene, g in gaps.items()} == {
        "kitchen": ("ingest", "failed"),
        "room_1": ("geometry", "outdated"),
        "room_2": ("benchmark", "missing"),
    }
    assert f"version {geometry.version - 1}" in gaps["room_1"]["reason"]
    counts = {"stored": 1, "missing": 0, "outdated": 1, "failed": 0, "waiting": 1}
    assert stages["geometry"] == {**counts, "seconds": [pytest.approx(seconds)] * 3}
    times = [
        sum(counts[state] for state in ("missing", "outdated", "failed", "waiting")) * seconds[1]
        for counts in stages.values()
        if (seconds := counts["seconds"])
    ]
    assert backlog["unknown"] == [] and backlog["seconds"][1] == pytest.approx(sum(times))
    assert files_below(tmp_path / "store", (".prefect",)) == before
    _, text, _ = slg("store", "status", config)
    assert "complete: 0 of 3; the rest takes" in text and "room_2" in text

    _, _, errors = slg("run", config, "--only-missing")
    assert "complete in the store: 0 of 3 scenes" in errors
    record.unlink()
    code, _, errors = slg("run", config, "--only-missing", "-v")
    assert code == 1 and "left out: 1, the first at ingest" in errors
    lines = errors.splitlines()
    assert "complete in the store: 1 of 3 scenes" in lines
    assert [line for line in lines if line.startswith("room_1  geometry")]
    assert not [line for line in lines if line.startswith("room_2  ")]
    assert "complete in the store: 2 of 2 answers" in lines
    assert files_below(tmp_path / "out", ("times", "report")) == first
    _, _, errors = slg("run", config, "--only-missing", "--refresh", "truth", "-v")
    assert "complete in the store: 0 of 3 scenes" in errors
    assert re.search(r"^room_1  truth  [\d.]+ s$", errors, re.MULTILINE)


def test_status_of_a_corpus_looks_up_its_lessons(status, tmp_path):
    (tmp_path / "store").mkdir()
    config = tmp_path / "corpus.toml"
    config.write_text('sources = ["procedural:0-1"]\nout = "corpus"\nstore = "store"\n')
    code, backlog = status(config)
    assert code == 1 and backlog["unknown"] == [*backlog["stages"]]
    assert [*backlog["stages"]] == ["packed", "views", "pairs", "predictions", "lessons"]
    assert [(gap["scene"], gap["stage"]) for gap in backlog["gaps"]] == [
        ("procedural_0", "packed"),
        ("procedural_1", "packed"),
    ]
