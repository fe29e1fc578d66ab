"""Alerts by a real Prefect server to a real webhook, after real ends of runs."""

import http.server
import json
import os
import queue
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest
from prefect.settings import PREFECT_API_URL, temporary_settings

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
    received: queue.Queue = queue.Queue()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            received.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *words):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as hook:
        threading.Thread(target=hook.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{hook.server_port}/", received
        hook.shutdown()


@pytest.fixture(scope="module")
def full_server(tmp_path_factory, alerts):
    """Environment of programs that use a server with all its services and our automations."""
    home = tmp_path_factory.mktemp("prefect")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}/api"
    ours = "SLGAUSSIAN_", "PREFECT_"  # set by other tests
    env = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    env |= {"PREFECT_HOME": str(home), "PREFECT_SERVER_ANALYTICS_ENABLED": "false"}
    env |= {"PREFECT_API_URL": url, "PREFECT_FLOWS_HEARTBEAT_FREQUENCY": "30"}
    command = [sys.executable, "-m", "prefect", "server", "start", "--port", str(port)]
    with (home / "log").open("wb") as log:
        server = subprocess.Popen(command, env=env, stdout=log, stderr=log, start_new_session=True)
    try:
        wait(lambda: answers(f"{url}/health"), 120)
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
    finally:
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def answers(url):
    try:
        return httpx.get(url).is_success
    except httpx.HTTPError:
        return False


def wait(condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.3)


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
    env = {**env, "PYTHONPATH": str(ROOT)}
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
    env = {**full_server, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", STATES], env=env, check=True, timeout=120)
    states = set()
    while not states >= {"Refused", "Regressed"}:
        states.add(alerts[1].get(timeout=60)["state"])
    assert not {"Promoted", "NothingNew", "Busy"} & states


def test_a_killed_run_is_marked_as_crashed_and_tells_the_webhook(full_server, alerts, tmp_path):
    run = start(full_server, tmp_path / "run", *((f"room {k}", k, 30) for k in range(8)))
    runs = f"{full_server['PREFECT_API_URL']}/flow_runs/filter"
    running = {"flow_runs": {"state": {"type": {"any_": ["RUNNING"]}}}}
    wait(lambda: httpx.post(runs, json=running).json(), 120)
    time.sleep(5)  # the first heartbeat is on its way
    run.kill()
    run.wait()
    assert "no heartbeat" in receive(alerts, "Crashed")["message"]
    assert httpx.post(runs, json=running).json() == []


def test_a_cancelled_run_closes_its_tasks_and_logs_no_traceback(full_server, tmp_path):
    """Cancelled as from Prefect's page, in a worker's process, while threads compute stages."""
    env = {**full_server, "PYTHONPATH": str(ROOT)}
    shutil.copy(ROOT / "prefect.yaml", tmp_path)
    prefect = [sys.executable, "-m", "prefect"]
    for words in ("work-pool create slgaussian --type process", "--no-prompt deploy --name report"):
        subprocess.run([*prefect, *words.split()], cwd=tmp_path, env=env, check=True, timeout=120)
    api = httpx.Client(base_url=full_server["PREFECT_API_URL"], timeout=60)
    with (tmp_path / "log").open("wb") as log:
        command = [*prefect, "worker", "start", "--pool", "slgaussian"]
        worker = subprocess.Popen(command, cwd=tmp_path, env=env, stdout=log, stderr=log)
    try:
        deployment = api.get("/deployments/name/slgaussian/report").json()["id"]
        config = {"rooms": "0-9", "out": str(tmp_path / "out"), "store": str(tmp_path / "store")}
        ordered = {"parameters": {"config": config}}
        run = api.post(f"/deployments/{deployment}/create_flow_run", json=ordered).json()["id"]
        of_run = {"flow_runs": {"id": {"any_": [run]}}}
        open_tasks = {**of_run, "task_runs": {"state": {"type": {"any_": ["PENDING", "RUNNING"]}}}}
        wait(lambda: len(api.post("/task_runs/filter", json=open_tasks).json()) > 2, 120)
        cancel = {"state": {"type": "CANCELLING"}}
        assert api.post(f"/flow_runs/{run}/set_state", json=cancel).is_success
        wait(lambda: api.get(f"/flow_runs/{run}").json()["state_type"] == "CANCELLED", 90)
        wait(lambda: api.post("/task_runs/filter", json=open_tasks).json() == [], 30)
    finally:
        worker.send_signal(signal.SIGINT)
        worker.wait(timeout=60)
    text = (tmp_path / "log").read_text()
    assert "was cancelled" in text and "Traceback" not in text, text
