"""Threads, processes, and real clusters of Dask and Ray give the same results."""

import importlib.util
import io
import json
import socket
from pathlib import Path

import pytest
from command import files_below
from tiny_clusters import dask_cluster, free_port, ray_cluster
from tiny_run import run_tiny, tiny

from flows.runners import task_runners
from flows.runners.progress import Progress
from flows.runners.task_runners import NO_EVENTS, last_line, roll_call
from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactStore

pytestmark = pytest.mark.usefixtures("server")

needs_dask, needs_ray = (
    pytest.mark.skipif(
        importlib.util.find_spec(f"prefect_{kind}") is None, reason=f"needs the extra `{kind}`"
    )
    for kind in ("dask", "ray")
)
KINDS = ["processes", pytest.param("dask", marks=needs_dask)]
RAY = pytest.param("ray", marks=[needs_ray, pytest.mark.whole])


@pytest.fixture(scope="module")
def dask(server):
    """Address of a running cluster."""
    with dask_cluster() as address:
        yield address


@pytest.fixture(scope="module")
def ray(server):
    with ray_cluster() as address:
        yield address


@pytest.fixture
def runner(kind, request):
    return request.getfixturevalue(kind) if kind in ("dask", "ray") else kind


def artifacts(store: ArtifactStore) -> dict[str, bytes]:
    return files_below(Path(store.path), ("keys/", ".prefect/"))


def read_refs(store: ArtifactStore) -> dict[str, list]:
    """References in the records by the paths of these, without times."""
    records = files_below(Path(store.path, "keys"))
    refs = {name: json.loads(data) for name, data in records.items()}
    return {name: [ref["spec"], ref["uri"], ref["digest"]] for name, ref in refs.items()}


def five_scenes(folder: Path, **effects: str) -> dict:
    """Three good scenes and two that fail; the ``effects`` are of the good scene `mortal`."""
    log = folder / "log"
    return {
        "a": tiny(6, 1, log),
        "bad": tiny(-1, 1, log),
        "mortal": tiny(20, 1, log, **effects),
        "defect": tiny(666, 1, log),
        "b": tiny(30, 2, log),
    }


@pytest.fixture(scope="module")
def run_in_threads(server, tmp_path_factory):
    """Store and outcome of threads, undisturbed."""
    folder = tmp_path_factory.mktemp("threads")
    store = ArtifactStore(folder / "store")
    outcome = run_tiny(store, five_scenes(folder), runner="threads")
    assert sorted(outcome.refs) == ["a", "b", "mortal"]
    return store, outcome


@pytest.mark.parametrize("kind", [*KINDS, RAY])
def test_worker_death_does_not_change_results(
    kind, runner, run_in_threads, store, tmp_path, monkeypatch
):
    """One scene kills its worker the first time; other scenes are in the same batch."""
    # Workers send events to the server, as to a server of the user.
    monkeypatch.delenv(NO_EVENTS, raising=False)
    scenes = five_scenes(tmp_path, **{"deadly once": str(tmp_path / "died")})
    progress = Progress(len(scenes), 3, stream=io.StringIO())
    outcome = run_tiny(store, scenes, 1, runner=runner, progress=progress)
    assert (tmp_path / "died").exists()
    expected_store, expected_outcome = run_in_threads
    assert outcome.refs == expected_outcome.refs
    assert outcome.failures == expected_outcome.failures
    assert artifacts(store) == artifacts(expected_store)
    assert read_refs(store) == read_refs(expected_store)

    # Progress counts each stage and scene once.
    assert (progress.done, progress.failed, progress.scenes) == (3, 2, 5)
    assert progress.steps == progress.total == 9
    assert "a worker died" in progress.console.file.getvalue() or kind == "dask"

    # Threads find all results of the other runner in the store.
    (tmp_path / "log").write_text("")
    good = {name: scenes[name] for name in ("a", "b", "mortal")}
    assert run_tiny(store, good, 1).refs == expected_outcome.refs
    assert (tmp_path / "log").read_text() == ""


@pytest.mark.parametrize("kind", KINDS)
def test_scene_that_always_kills_its_worker_is_left_out(kind, runner, store, tmp_path):
    log = tmp_path / "log"
    scenes = {"killer": tiny(6, 1, log, deadly="halve"), "good": tiny(8, 1, log)}
    progress = Progress(2, 3, stream=io.StringIO())
    outcome = run_tiny(store, scenes, 1, runner=runner, progress=progress)
    assert sorted(outcome.refs) == ["good"]
    (failure,) = outcome.failures
    assert (failure.scene, failure.stage, failure.kind) == ("killer", "make", "WorkerDied")
    assert failure.reason.startswith("its worker died (")
    assert failure.reason.isprintable() and len(failure.reason) < 500
    assert (progress.done, progress.failed) == (1, 1)
    # The retry finds the stage that ended before the death in the store.
    assert log.read_text().count("killer make") == 1


class Unreadable:
    """An object that pickles, and whose pickle raises an error when it is read."""

    def __reduce__(self):
        return (int, ("no number",))


@pytest.mark.parametrize("kind", ["threads", *KINDS])
def test_error_in_worker_is_reported_and_is_no_death(kind, runner, store, tmp_path):
    log = tmp_path / "log"
    scenes = {
        "defect": tiny(666, 1, log),
        "exit": tiny(667, 1, log),
        "good": tiny(8, 1, log),
        "unreadable": tiny(6, 1, log, unreadable=Unreadable()),
    }
    progress = Progress(len(scenes), 3, stream=io.StringIO())
    outcome = run_tiny(store, scenes, 1, runner=runner, progress=progress)
    assert sorted(outcome.refs) == ["good"]
    reasons = {failure.scene: failure.reason for failure in outcome.failures}
    assert reasons["defect"] == "unexpected ZeroDivisionError: a defect"
    assert reasons["exit"] == "unexpected SystemExit: 3"
    assert reasons["unreadable"].startswith("its worker raised ValueError: invalid literal for int")
    output = progress.console.file.getvalue()
    assert "a worker raised ValueError" in output
    assert "died" not in output + str(reasons)


@needs_dask
def test_run_refuses_an_address_without_scheduler(store, monkeypatch):
    monkeypatch.setattr(task_runners, "CONNECT_TIMEOUT", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        for port, reason in (
            (free_port(), "refused"),
            (0, "refused"),
            (99999, "out of range"),
            (silent.getsockname()[1], ""),
        ):
            with pytest.raises(InputError, match=f"no Dask scheduler answers at.*{reason}"):
                run_tiny(store, {}, runner=f"dask://127.0.0.1:{port}")


@needs_dask
def test_run_refuses_a_cluster_without_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(task_runners, "FIRST_TASK_TIMEOUT", 0.5)
    message = "no worker of dask://.* accepted work within"
    with dask_cluster(workers=0) as runner, pytest.raises(InputError, match=message):
        run_tiny(ArtifactStore(tmp_path), {}, runner=runner)
    assert not list(tmp_path.glob(".probe*"))


def test_roll_call_refuses_another_store(store):
    store.write("probe", b"")
    roll_call.fn(store.root, "probe")
    with pytest.raises(InputError, match="another store at"):
        roll_call.fn(store.root, "another")


def test_last_line_of_error_is_its_cause():
    grpc = pytest.importorskip("grpc")
    with (
        grpc.insecure_channel(f"127.0.0.1:{free_port()}") as channel,
        pytest.raises(grpc.RpcError) as error,
    ):
        channel.unary_unary("/service/method")(b"", timeout=5)
    assert last_line(str(error.value)).startswith("details = ")
    assert "127.0.0.1" in last_line(str(error.value))
    assert last_line("Traceback:\n  a line\nValueError: cause\n") == "ValueError: cause"
    assert last_line("") == "unknown"
