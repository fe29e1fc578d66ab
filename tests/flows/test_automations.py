"""Alerts by a real Prefect server to a real webhook, after real ends of runs."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from prefect.settings import PREFECT_API_URL, temporary_settings
from tiny_program import wait_until
from web import call_prefect, post, receive_json, serve_prefect, start_prefect

from flows.automations import apply_automations, read_automations

pytestmark = pytest.mark.whole

ROOT = Path(__file__).parents[2]

ROOM = """
[[scenes]]
name = "{}"
format = "procedural"
options = {{seed = {}, objects = 4, views = {}}}
context = ["view_00", "view_02"]
queries = ["red ball"]
"""

STATES = """
from prefect import flow
from prefect.states import State
from flows.retraining import STATE_TYPES
from flows.runners.environment import call_flow
from flows.runners.session import final

@flow(name="slgaussian-retrain", persist_result=False)
def end(outcome):
    name = outcome.title().replace(" ", "")
    return final(State(type=STATE_TYPES[outcome], name=name, message="why", data=outcome))

assert [call_flow(end, outcome) for outcome in STATE_TYPES] == [*STATE_TYPES]
"""


@pytest.fixture(scope="module")
def alerts():
    """A webhook on this machine: its URL, and a queue of what it received."""
    with receive_json() as hook:
        yield hook


@pytest.fixture(scope="module")
def full_server(tmp_path_factory, alerts):
    """Environment of programs that use a server with all its services and our automations."""
    variables = {"PREFECT_FLOWS_HEARTBEAT_FREQUENCY": "30"}
    with serve_prefect(tmp_path_factory.mktemp("prefect"), **variables) as env:
        url = env["PREFECT_API_URL"]
        assert wait_until(lambda: is_ready(f"{url}/health"), 120)
        automations = read_automations()
        for automation in automations:
            if automation["trigger"]["posture"] == "Proactive":
                automation["trigger"]["within"] = 35
        with temporary_settings({PREFECT_API_URL: url}):
            for _ in range(2):  # a second time, they are updated
                apply_automations(automations, alerts[0])
        stored = httpx.post(f"{url}/automations/filter", json={}).json()
        assert [a["name"] for a in stored] == [a["name"] for a in automations]
        yield env


def is_ready(url):
    try:
        return httpx.get(url).is_success
    except httpx.HTTPError:
        return False


def receive(alerts, state) -> dict:
    """Wait for an alert of this state; a busy server may tell of an earlier one twice."""
    while (alert := alerts[1].get(timeout=150))["state"] != state:
        pass
    return alert


def start(env, folder, *rooms) -> subprocess.Popen:
    """Start a run of ``(name, seed, views)`` of procedural rooms; of one view they fail."""
    folder.mkdir()
    (folder / "run.toml").write_text("".join(ROOM.format(*room) for room in rooms))
    program = "from flows.cli.app import main; main()"
    command = [sys.executable, "-c", program, "run", "run.toml", "-o", "out"]
    return subprocess.Popen(command, cwd=folder, env=env)


@pytest.mark.parametrize(
    ("rooms", "state"),
    [
        ([("a", 0, 1), ("b", 1, 1)], "Failed"),
        ([("a", 0, 1), ("fine", 1, 3)], "LeftOut"),
    ],
)
def test_a_run_that_left_scenes_out_tells_the_webhook(full_server, alerts, tmp_path, rooms, state):
    assert start(full_server, tmp_path / "run", *rooms).wait(timeout=200) == 1
    alert = receive(alerts, state)
    assert alert["flow"] == "slgaussian"
    assert "left out: a" in alert["text"] and "views: found 1" in alert["message"]


def test_outcomes_to_look_at_tell_the_webhook_and_others_do_not(full_server, alerts):
    subprocess.run([sys.executable, "-c", STATES], env=full_server, check=True, timeout=120)
    states = set()
    while not states >= {"Refused", "Regressed"}:
        states.add(alerts[1].get(timeout=60)["state"])
    assert not {"Promoted", "NothingNew", "Busy"} & states


def test_a_killed_run_is_marked_as_crashed_and_tells_the_webhook(full_server, alerts, tmp_path):
    run = start(full_server, tmp_path / "run", *((f"room {k}", k, 30) for k in range(8)))
    runs = f"{full_server['PREFECT_API_URL']}/flow_runs/filter"
    running = {"flow_runs": {"state": {"type": {"any_": ["RUNNING"]}}}}
    assert wait_until(lambda: httpx.post(runs, json=running).json(), 120)
    time.sleep(5)  # the first heartbeat is on its way
    run.kill()
    run.wait()
    assert "no heartbeat" in receive(alerts, "Crashed")["message"]
    assert httpx.post(runs, json=running).json() == []


def list_open_tasks(env, **scope) -> set[str]:
    """List the ids of the tasks that a server has as pending or running."""
    is_open = {"task_runs": {"state": {"type": {"any_": ["PENDING", "RUNNING"]}}}}
    tasks = post(f"{env['PREFECT_API_URL']}/task_runs/filter", {**scope, **is_open})
    return {task["id"] for task in tasks.json()}


def test_a_signal_to_a_run_closes_its_tasks_on_the_server(full_server, tmp_path):
    earlier = list_open_tasks(full_server)  # of the run that was killed
    run = start(full_server, tmp_path / "run", *((f"room {k}", k, 30) for k in range(8)))
    assert wait_until(lambda: len(list_open_tasks(full_server) - earlier) > 1, 120)
    run.terminate()
    assert run.wait(timeout=60) == -signal.SIGTERM
    assert list_open_tasks(full_server) <= earlier


def test_a_cancelled_run_closes_its_tasks_and_logs_no_traceback(full_server, tmp_path):
    """Cancelled as from Prefect's page, in a worker's process, while threads compute stages."""
    shutil.copy(ROOT / "prefect.yaml", tmp_path)
    call_prefect(tmp_path, full_server, *["work-pool", "create", "slgaussian", "--type", "process"])
    call_prefect(tmp_path, full_server, "deploy", "--name", "report")
    api = httpx.Client(base_url=full_server["PREFECT_API_URL"], timeout=60)

    with start_prefect(tmp_path, full_server, "worker", "start", "--pool", "slgaussian") as log:
        deployment = api.get("/deployments/name/slgaussian/report").json()["id"]
        config = {"rooms": "0-9", "out": str(tmp_path / "out"), "store": str(tmp_path / "store")}
        ordered = {"parameters": {"config": config}}
        run = api.post(f"/deployments/{deployment}/create_flow_run", json=ordered).json()["id"]
        of_run = {"flow_runs": {"id": {"any_": [run]}}}
        assert wait_until(lambda: len(list_open_tasks(full_server, **of_run)) > 2, 120)
        cancel = {"state": {"type": "CANCELLING"}}
        assert api.post(f"/flow_runs/{run}/set_state", json=cancel).is_success
        flow_run = f"/flow_runs/{run}"
        assert wait_until(lambda: api.get(flow_run).json()["state_type"] == "CANCELLED", 90)
        assert wait_until(lambda: not list_open_tasks(full_server, **of_run), 30)
    text = log.read_text()
    assert "was cancelled" in text and "Traceback" not in text, text
