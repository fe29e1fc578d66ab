"""Threads, processes and real clusters of Dask and Ray: the same work, the same results."""

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
ANY = ["processes", pytest.param("dask", marks=needs_dask)]
RAY = pytest.param("ray", marks=[needs_ray, pytest.mark.whole])


@pytest.fixture(scope="module")
def dask(server):
    """The address of a cluster that runs already."""
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


def refs_of(store: ArtifactStore) -> dict[str, dict]:
    """What the records say was made by which work, without when and how fast."""
    files = Path(store.path, "keys").rglob("*.json")
    read = {str(p.relative_to(store.path)): json.loads(p.read_bytes()) for p in files}
    return {name: [ref["spec"], ref["uri"], ref["digest"]] for name, ref in read.items()}


def plans_of(folder: Path, **where: str) -> dict:
    log = folder / "log"
    return {
        "a": tiny(6, 1, log),
        "bad": tiny(-1, 1, log),
        "mortal": tiny(20, 1, log, **where),
        "defect": tiny(666, 1, log),
        "b": tiny(30, 2, log),
    }


@pytest.fixture(scope="module")
def expected(server, tmp_path_factory):
    """What threads make of it, undisturbed."""
    folder = tmp_path_factory.mktemp("threads")
    store = ArtifactStore(folder / "store")
    outcome = run_tiny(store, plans_of(folder), runner="threads")
    assert sorted(outcome.refs) == ["a", "b", "mortal"]
    return store, outcome


@pytest.mark.parametrize("kind", [*ANY, RAY])
def test_every_runner_makes_the_same_of_it_though_a_worker_dies(
    kind, runner, expected, tmp_path, monkeypatch
):
    """One scene kills its worker the first time; its neighbours are in the same batch."""
    # Workers tell the server of all that they do, as if it were the user's.
    monkeypatch.delenv(NO_EVENTS, raising=False)
    store = ArtifactStore(tmp_path / "store")
    plans = plans_of(tmp_path, **{"deadly once": str(tmp_path / "died")})
    report = Progress(len(plans), 3, stream=io.StringIO())
    outcome = run_tiny(store, plans, 1, runner=runner, progress=report)
    assert (tmp_path / "died").exists()
    first, wanted = expected
    assert outcome.refs == wanted.refs
    assert outcome.failures == wanted.failures
    assert artifacts(store) == artifacts(first)
    assert refs_of(store) == refs_of(first)

    # Nothing is counted twice, by those who are told of it either.
    assert (report.done, report.failed, report.scenes) == (3, 2, 5)
    assert report.steps == report.total == 9
    assert "a worker died" in report.console.file.getvalue() or kind == "dask"

    # And once more: all is there, whoever made it.
    (tmp_path / "log").write_text("")
    good = {name: plans[name] for name in ("a", "b", "mortal")}
    rerun = run_tiny(store, good, 1)
    assert rerun.refs == wanted.refs
    assert (tmp_path / "log").read_text() == ""


@pytest.mark.parametrize("kind", ANY)
def test_a_scene_that_always_kills_its_worker_is_left_out(kind, runner, tmp_path):
    store, log = ArtifactStore(tmp_path / "store"), tmp_path / "log"
    plans = {"killer": tiny(6, 1, log, deadly="halve"), "good": tiny(8, 1, log)}
    report = Progress(2, 3, stream=io.StringIO())
    outcome = run_tiny(store, plans, 1, runner=runner, progress=report)
    assert sorted(outcome.refs) == ["good"]
    (failure,) = outcome.failures
    assert (failure.scene, failure.stage, failure.kind) == ("killer", "make", "WorkerDied")
    assert failure.reason.startswith("its worker died (")
    assert failure.reason.isprintable() and len(failure.reason) < 500
    assert (report.done, report.failed) == (1, 1)
    # What it had made before it died is kept.
    assert log.read_text().count("killer make") == 1


class Unreadable:
    """What can be sent, and not be read by whom it is sent to."""

    def __reduce__(self):
        return (int, ("no number",))


@pytest.mark.parametrize("kind", ["threads", *ANY])
def test_an_error_of_a_worker_is_told_and_is_no_death(kind, runner, tmp_path):
    log = tmp_path / "log"
    plans = {
        "defect": tiny(666, 1, log),
        "exit": tiny(667, 1, log),
        "good": tiny(8, 1, log),
        "unreadable": tiny(6, 1, log, what=Unreadable()),
    }
    report = Progress(len(plans), 3, stream=io.StringIO())
    store = ArtifactStore(tmp_path / "store")
    outcome = run_tiny(store, plans, 1, runner=runner, progress=report)
    assert sorted(outcome.refs) == ["good"]
    reasons = {failure.scene: failure.reason for failure in outcome.failures}
    assert reasons["defect"] == "unexpected ZeroDivisionError: a defect"
    assert reasons["exit"] == "unexpected SystemExit: 3"
    assert reasons["unreadable"].startswith("its worker raised ValueError: invalid literal for int")
    assert "a worker raised ValueError" in report.console.file.getvalue()
    assert "died" not in report.console.file.getvalue() + str(reasons)


@needs_dask
def test_a_server_that_is_no_scheduler_is_not_waited_for_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(task_runners, "CONNECT_TIMEOUT", 0.5)
    message = "no Dask scheduler answers at"
    for port, reason in ((free_port(), "refused"), (0, "refused"), (99999, "out of range")):
        with pytest.raises(InputError, match=f"{message}.*{reason}"):
            run_tiny(ArtifactStore(tmp_path), {}, runner=f"dask://127.0.0.1:{port}")
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(InputError, match=message):
        runner = f"dask://127.0.0.1:{server.getsockname()[1]}"
        run_tiny(ArtifactStore(tmp_path), {}, runner=runner)


@needs_dask
def test_a_cluster_without_workers_is_not_waited_for_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(task_runners, "FIRST_TASK_TIMEOUT", 0.5)
    message = "no worker of dask://.* accepted work within"
    with dask_cluster(workers=0) as runner, pytest.raises(InputError, match=message):
        run_tiny(ArtifactStore(tmp_path), {}, runner=runner)
    assert not list(tmp_path.glob(".probe*"))


def test_a_worker_that_cannot_work_says_why(server, tmp_path):
    """What it is asked before it is given work."""
    store = ArtifactStore(tmp_path)
    store.write("probe", b"")
    roll_call.fn(store.root, "probe")
    with pytest.raises(InputError, match="another store at"):
        roll_call.fn(store.root, "another")


def test_the_cause_of_an_error_of_grpc():
    grpc = pytest.importorskip("grpc")
    with (
        grpc.insecure_channel(f"127.0.0.1:{free_port()}") as channel,
        pytest.raises(grpc.RpcError) as caught,
    ):
        channel.unary_unary("/service/method")(b"", timeout=5)
    assert last_line(str(caught.value)).startswith("details = ")
    assert "127.0.0.1" in last_line(str(caught.value))
    assert last_line("Traceback:\n  a line\nValueError: cause\n") == "ValueError: cause"
    assert last_line("") == "unknown"
