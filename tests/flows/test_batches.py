import io
import pickle
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
from tiny_run import run_tiny, tiny
from tiny_stages import tiny_pipeline

from flows.runners.batches import (
    MAX_BATCH,
    SceneTask,
    TooManyFailuresError,
    run_batch,
    write_failures,
)
from flows.runners.session import check_refresh
from slgaussian.errors import InputError
from slgaussian.storage.store import DamagedError, StoreError

pytestmark = pytest.mark.usefixtures("server")


@pytest.fixture
def runs(store, tmp_path):
    """Run two scenes, all of whose artifacts differ; return outcome and executed stages."""
    log = tmp_path / "log"

    def run(a=6, b=20, extra=1):
        log.write_text("")
        outcome = run_tiny(store, {"a": tiny(a, extra, log), "b": tiny(b, extra, log)})
        assert outcome.failures == []
        return outcome, sorted(log.read_text().splitlines())

    return run


ALL = ["a add", "a halve", "a make", "b add", "b halve", "b make"]


def test_a_run_computes_what_depends_on_what_changed_and_nothing_else(runs):
    first, ran = runs()
    assert ran == ALL
    repeated, ran = runs()
    assert ran == [] and repeated.refs == first.refs
    for values, expected in (
        ({"extra": 2}, ["a add", "b add"]),
        ({"extra": 2, "b": 80}, ["b add", "b halve", "b make"]),
        ({"a": 7}, ["a halve", "a make"]),  # whose half is the same
    ):
        assert runs(**values)[1] == expected


@pytest.mark.parametrize("damage", ["delete", "cut", "alter"])
def test_only_a_lost_or_damaged_artifact_is_made_again(runs, store, damage):
    outcome, _ = runs()
    path = Path(store.path) / outcome.refs["b"]["halve"].uri
    full = path.read_bytes()
    if damage == "delete":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(full[: len(full) // 2])
    else:
        path.write_bytes(full[:100] + bytes([full[100] ^ 1]) + full[101:])
    rerun, ran = runs()
    assert ran == ["b halve"]
    assert rerun.refs == outcome.refs
    assert path.read_bytes() == full


def test_a_refreshed_stage_and_what_follows_are_computed_anew(store, tmp_path):
    log = tmp_path / "log"
    first = run_tiny(store, {"a": tiny(6, 1, log)})
    log.write_text("")
    rerun = run_tiny(store, {"a": tiny(6, 1, log)}, refresh=("halve",))
    assert log.read_text().splitlines() == ["a halve", "a add"] and rerun.refs == first.refs
    log.write_text("")
    run_tiny(store, {"a": tiny(6, 1, log)})
    assert log.read_text() == ""
    with pytest.raises(InputError, match="'haive', expected one of the stages make"):
        check_refresh(SimpleNamespace(refresh=["haive"]), ["make", "halve"])


def test_map_scenes_leaves_out_bad_scenes_by_name(store, tmp_path):
    log = tmp_path / "log"
    scenes = {
        "good": tiny(4, 1, log),
        "bad": tiny(-1, 1, log),
        "defect": tiny(666, 1, log),
        "unkeyable": ({1, 2}, 1, {}),
        "fine": tiny(6, 1, log),
    }
    view = io.StringIO()
    outcome = run_tiny(store, scenes, stream=view)
    assert sorted(outcome.refs) == ["fine", "good"]
    write_failures(tmp_path, outcome.failures)
    bad, defect, unkeyable = pq.read_table(tmp_path / "failures.parquet").to_pylist()
    assert bad == {
        "scene": "bad",
        "stage": "make",
        "kind": "InputError",
        "reason": "value -1: expected a positive number",
    }
    assert defect["reason"] == "unexpected ZeroDivisionError: a defect"
    assert "value: set {1, 2} cannot be part of a cache key" in unkeyable["reason"]
    assert "bad  left out at make: value -1" in view.getvalue()
    assert "Traceback" not in view.getvalue()


@pytest.mark.parametrize(
    ("bad", "limit", "stops"),
    [(3, 0.5, 0), (25, 0.5, 21), (25, 30, 0), (25, 2, 3), (30, 0.9, 21), (30, 1e9, 0)],
)
def test_map_scenes_stops_beyond_max_failures(store, tmp_path, bad, limit, stops):
    log = tmp_path / "log"
    scenes = {f"{k:02d}": tiny(-1 if k < bad else 4, 1, log) for k in range(32)}
    if not stops:
        outcome = run_tiny(store, scenes, 1, max_failures=limit)
        assert len(outcome.failures) == bad and len(outcome.refs) == 32 - bad
        return
    with pytest.raises(TooManyFailuresError, match=r"stopped: .* value -1: expected") as stopped:
        run_tiny(store, scenes, 1, max_failures=limit)
    assert stops <= len(stopped.value.failures) < stops + MAX_BATCH


@pytest.mark.parametrize("runner", ["threads", "processes"])
def test_a_store_that_fails_stops_the_run_at_its_first_scene(store, tmp_path, runner):
    log = tmp_path / "log"
    scenes = {f"{k}": tiny(4 + k, 1, log) for k in range(8)}
    Path(store.path).mkdir()
    (Path(store.path) / "labels").write_text("in the way of the folder")
    with pytest.raises(StoreError, match="cannot write there"):
        run_tiny(store, scenes, 1, runner=runner)
    assert log.read_text().splitlines() == ["0 make"]


@pytest.mark.parametrize(
    ("kinds", "state"), [([4, 6], "Completed"), ([-1, 4], "LeftOut"), ([-1, -1], "Failed")]
)
def test_a_batch_has_the_state_of_its_scenes(store, tmp_path, kinds, state):
    tasks = [
        SceneTask(f"{k}", tiny_pipeline, tiny(value, 1, tmp_path / "log"), "make")
        for k, value in enumerate(kinds)
    ]
    batch = pickle.dumps((store.root, tasks, 1, frozenset()))
    ended = run_batch("batch", batch, return_state=True)
    assert ended.name == state and ended.is_failed() == (state == "Failed")
    assert len(ended.result(raise_on_failure=False)) == 2
    assert ("left out: 0" in (ended.message or "")) == (state != "Completed")


def test_no_more_scenes_than_workers_are_open_at_once(store, tmp_path):
    log = tmp_path / "log"
    scenes = {f"{i}": tiny(2 * i + 2, 1, log) for i in range(5)}
    run_tiny(store, scenes, workers=1)
    order = [line.split()[0] for line in log.read_text().splitlines()]
    assert order == sorted(order)


def test_an_artifact_that_is_damaged_while_a_run_is_on_is_made_again_by_the_next(
    store, tmp_path, monkeypatch
):
    import tiny_stages

    log, halved = tmp_path / "log", tiny_stages.halve.compute

    def spoil(run, output, where):
        (Path(store.path) / output.uri).write_bytes(b"spoilt")
        return halved(run, output, where)

    scenes = {"a": tiny(6, 1, log), "b": tiny(8, 1, log)}
    with monkeypatch.context() as patch, pytest.raises(DamagedError):
        patch.setattr(tiny_stages.halve, "compute", spoil)
        run_tiny(store, scenes)
    log.write_text("")
    outcome = run_tiny(store, scenes)
    assert outcome.failures == [] and sorted(log.read_text().splitlines()) == ALL
    assert store.get(outcome.refs["a"]["make"])["labels"].max() == 6
