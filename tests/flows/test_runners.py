"""Threads, processes and real clusters of Dask and Ray: the same work, the same results."""

import importlib.util
import io
import json
from pathlib import Path

import pytest
from tiny_clusters import dask_cluster, ray_cluster
from tiny_run import chain_plan, run_tiny

from flows import chains
from flows.chains import failures_table
from flows.progress import Progress
from slgaussian.store import ArtifactStore

pytestmark = pytest.mark.usefixtures("server")

needs = {
    kind: pytest.mark.skipif(
        importlib.util.find_spec(f"prefect_{kind}") is None, reason=f"needs the extra `{kind}`"
    )
    for kind in ("dask", "ray")
}
ANY = [
    "processes",
    pytest.param("dask", marks=needs["dask"]),
    pytest.param("ray", marks=needs["ray"]),
]


@pytest.fixture(scope="module")
def clusters():
    """The runner of each kind; Dask and Ray are clusters that run already, begun when asked for."""
    from contextlib import ExitStack

    begin = {"dask": dask_cluster, "ray": ray_cluster}
    with ExitStack() as stack:
        running = {"threads": "threads", "processes": "processes"}

        def runner(kind):
            if kind not in running:
                running[kind] = stack.enter_context(begin[kind]())
            return running[kind]

        yield runner


def artifacts(store: ArtifactStore) -> dict[str, bytes]:
    root = Path(store.path)
    kept = (p for p in sorted(root.rglob("*")) if p.is_file())
    named = ((str(p.relative_to(root)), p) for p in kept)
    return {n: p.read_bytes() for n, p in named if not n.startswith(("keys/", ".prefect/"))}


def refs_of(store: ArtifactStore) -> dict[str, dict]:
    """What the records say was made by which work, without when and how fast."""
    files = Path(store.path, "keys").rglob("*.json")
    read = {str(p.relative_to(store.path)): json.loads(p.read_bytes()) for p in files}
    return {name: [ref["spec"], ref["uri"], ref["digest"]] for name, ref in read.items()}


def plans_of(folder: Path, **where: str) -> dict:
    log = folder / "log"
    return {
        "a": chain_plan(6, 1, log),
        "bad": chain_plan(-1, 1, log),
        "mortal": chain_plan(20, 1, log, **where),
        "defect": chain_plan(666, 1, log),
        "b": chain_plan(30, 2, log),
    }


@pytest.fixture(scope="module")
def expected(server, tmp_path_factory):
    """What threads make of it, undisturbed."""
    folder = tmp_path_factory.mktemp("threads")
    store = ArtifactStore(folder / "store")
    outcome = run_tiny(store, plans_of(folder), runner="threads")
    assert sorted(outcome.refs) == ["a", "b", "mortal"]
    return store, outcome


@pytest.mark.parametrize("kind", ANY)
def test_every_runner_makes_the_same_of_it_though_a_worker_dies(kind, clusters, expected, tmp_path):
    """One scene kills its worker the first time; its neighbours are in the same shard."""
    store = ArtifactStore(tmp_path / "store")
    plans = plans_of(tmp_path, **{"deadly once": str(tmp_path / "died")})
    told = Progress(len(plans), 3, stream=io.StringIO())
    outcome = run_tiny(store, plans, 1, runner=clusters(kind), progress=told)
    assert (tmp_path / "died").exists()
    first, wanted = expected
    assert outcome.refs == wanted.refs
    table = failures_table(outcome.failures)
    assert table.equals(failures_table(wanted.failures))
    assert artifacts(store) == artifacts(first)
    assert refs_of(store) == refs_of(first)

    # Nothing is counted twice, by those who are told of it either.
    metrics = told.metrics()
    assert (metrics.done, metrics.failed, metrics.scenes) == (3, 2, 5)
    assert metrics.steps == metrics.stages == 9
    assert "a worker died" in told.display.stream.getvalue() or kind == "dask"

    # And once more: all is there, whoever made it.
    (tmp_path / "log").write_text("")
    good = {name: plans[name] for name in ("a", "b", "mortal")}
    again = run_tiny(store, good, 1, runner=clusters(kind))
    assert again.refs == wanted.refs
    assert (tmp_path / "log").read_text() == ""


@pytest.mark.parametrize("kind", ANY)
def test_a_scene_that_always_kills_its_worker_is_left_out(kind, clusters, tmp_path, monkeypatch):
    monkeypatch.setattr(chains, "DEATHS", 2)  # a new worker takes seconds to begin
    store, log = ArtifactStore(tmp_path / "store"), tmp_path / "log"
    plans = {"killer": chain_plan(6, 1, log, deadly="halve"), "good": chain_plan(8, 1, log)}
    told = Progress(2, 3, stream=io.StringIO())
    outcome = run_tiny(store, plans, 1, runner=clusters(kind), progress=told)
    assert sorted(outcome.refs) == ["good"]
    (failure,) = outcome.failures
    assert (failure.scene, failure.stage, failure.kind) == ("killer", "make", "WorkerDied")
    assert "its worker died, 2 times" in failure.reason
    assert "\x1b" not in failure.reason
    assert (told.metrics().done, told.metrics().failed) == (1, 1)
    # What it had made before it died is kept.
    assert log.read_text().count("killer make") == 1


def test_what_a_cluster_of_ours_listens_on(tmp_path):
    pytest.skip("see below")
