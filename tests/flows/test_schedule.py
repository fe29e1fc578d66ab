"""Deployments: the flows of the files can be loaded; runs as an operator sees them."""

import logging
import time
from pathlib import Path

import pytest
import yaml
from prefect.client.schemas.schedules import CronSchedule
from prefect.flows import load_flow_from_entrypoint
from web import post

from flows.benchmark import PAGE, REPORT, SCORES, score_scenes
from flows.config import RetrainSettings
from flows.read_config import make_settings
from flows.retraining import retrain
from flows.runners.task_runners import NO_EVENTS, send_events
from flows.scene import STAGES
from slgaussian.errors import InputError

ROOT = Path(__file__).parents[2]


DEPLOYMENTS = yaml.safe_load((ROOT / "prefect.yaml").read_text())["deployments"]


@pytest.mark.parametrize("deployment", DEPLOYMENTS, ids=[d["name"] for d in DEPLOYMENTS])
def test_the_deployments_of_the_repository_can_be_loaded_and_their_parameters_fit(deployment):
    loaded = load_flow_from_entrypoint(deployment["entrypoint"])
    loaded.validate_parameters(deployment["parameters"])
    for clock in deployment.get("schedules", []):
        CronSchedule(**clock)
    pool = deployment["work_pool"]
    assert pool["name"] == "slgaussian"
    extra = pool["job_variables"]["env"]["PREFECT_LOGGING_EXTRA_LOGGERS"]
    assert logging.getLogger(extra).handlers  # where that of the runs sends what it hears


def test_what_stops_a_run_fails_it(tmp_path, server):
    paths = {name: tmp_path / name for name in ("out", "models")}
    with pytest.raises(InputError, match="is not there"):
        retrain(
            RetrainSettings(
                sources=[str(tmp_path / "gone")], store=str(tmp_path / "store"), **paths
            )
        )
    # The server holds the runs of other tests too.
    runs = ended_runs(server, retrain.name)
    (ended,) = (run for run in runs if str(tmp_path) in (run["message"] or ""))
    assert ended["type"] == "FAILED" and "is not there" in ended["message"]


def test_a_run_names_the_scenes_that_it_left_out_and_has_edges_and_artifacts(
    tmp_path, server, monkeypatch
):
    """The state, edges and artifacts of a run, read from a real server by its API."""
    from command import ROOM

    monkeypatch.delenv(NO_EVENTS, raising=False)  # the server is the user's
    send_events(True)
    lost = {**ROOM, "name": "lost", "options": {"seed": 1, "objects": 4, "views": 1}}
    scenes = [{**ROOM, "queries": ["red ball"]}, lost]
    places = {"out": tmp_path / "scores", "store": str(tmp_path / "store")}
    for _ in range(2):
        score_scenes(make_settings({"size": "64x96", "scenes": scenes, **places}, "test"))
    report = tmp_path / "scores" / "report.html"
    message = f"report: {report}; left out: lost (ingest: procedural scene views: found 1, "
    # The server holds the runs of other tests too.
    runs = [
        run
        for run in ended_runs(server, score_scenes.name)
        if (run["message"] or "").startswith(message)
    ]
    assert [(run["type"], run["name"]) for run in runs] == [("COMPLETED", "LeftOut")] * 2
    again, first = runs
    of_run = {"flow_runs": {"id": {"any_": [again["flow_run"]]}}, "limit": 200}
    # What is found in the store costs one task run.
    tasks = [t for t in wait_for(server, of_run, 1) if t["name"].endswith("room")]
    assert [(t["name"], t["state_name"]) for t in tasks] == [("room", "Cached")]
    assert tasks[0]["state"]["message"] == "1 of 1 found in the store"
    of_run["flow_runs"]["id"]["any_"] = [first["flow_run"]]
    tasks = wait_for(server, of_run, 1 + len(STAGES))
    by_stage = {t["name"].split(" of ")[0]: t for t in tasks if t["name"].endswith(" of room")}
    assert by_stage.keys() == {stage.name for stage in STAGES}
    assert {t["state_name"] for t in by_stage.values()} == {"Completed"}
    ids = {t["id"]: stage for stage, t in by_stage.items()}
    edges = {
        stage: {ids[first["id"]] for first in t["task_inputs"]["inputs"]}
        for stage, t in by_stage.items()
    }
    assert edges["ingest"] == set() and edges["geometry"] == {"ingest"}
    assert edges["field"] == {"ingest", "geometry", "masks", "supervision"}
    assert edges["benchmark"] == {"ingest", "truth", "geometry", "masks", "field"}
    for ended in runs:
        of_run = {"artifacts": {"flow_run_id": {"any_": [ended["flow_run"]]}}}
        published = {
            first["key"]: first for first in post(f"{server.url}/artifacts/filter", of_run).json()
        }
        keys = {REPORT: "markdown", PAGE: "markdown", SCORES: "table"}
        types = {key: first["type"] for key, first in published.items()}
        assert types == {**keys, "slgaussian-progress": "progress"}
        assert all(first["description"] for first in published.values())
        assert published[PAGE]["data"] == f"[report.html]({report.as_uri()})"
        assert "IoU" in published[REPORT]["data"]
        assert float(published["slgaussian-progress"]["data"]) == 100


def ended_runs(server, name: str) -> list[dict]:
    """Return the final states of a flow's runs, latest first, with the ids of the runs."""
    which = {"flows": {"name": {"any_": [name]}}, "sort": "END_TIME_DESC"}
    runs = post(f"{server.url}/flow_runs/filter", which).json()
    return [{**first["state"], "flow_run": first["id"]} for first in runs]


def wait_for(server, which: dict, count: int) -> list[dict]:
    """Wait for task runs, which reach the server later, as events."""
    for _ in range(100):
        tasks = post(f"{server.url}/task_runs/filter", which).json()
        final = [t for t in tasks if t["state_type"] in ("COMPLETED", "FAILED")]
        if len(final) == len(tasks) and sum(t["name"].endswith("room") for t in tasks) >= count:
            return tasks
        time.sleep(0.2)
    raise AssertionError([(t["name"], t["state_name"]) for t in tasks])
