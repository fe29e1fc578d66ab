"""Schedules: what they need is said at once, and what the files promise can be loaded.

That they fire is shown by ``benches/schedule.py``: a server, and two times of a clock.
"""

import inspect
import time
from importlib import import_module
from pathlib import Path

import httpx
import pytest
import yaml
from command import run, said
from prefect.client.schemas.schedules import CronSchedule
from prefect.flows import load_flow_from_entrypoint

from slgaussian.errors import InputError

ROOT = Path(__file__).parents[2]


@pytest.fixture
def config(tmp_path):
    file = tmp_path / "retrain.toml"
    file.write_text(f'chunks = "{tmp_path}"\nout = "corpus"\nmodels = "models"\nstore = "store"\n')
    return file


def refused(monkeypatch, capsys, *arguments) -> str:
    assert run(monkeypatch, "retrain", *arguments) == 2
    return said(capsys)


def test_a_schedule_without_a_server_is_refused(config, monkeypatch, capsys):
    monkeypatch.delenv("PREFECT_API_URL")
    found = refused(monkeypatch, capsys, config, "--cron", "0 3 * * *")
    assert found.startswith("error: a schedule needs a Prefect server that keeps running")
    assert "prefect server start" in found and "or let cron run" in found
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")
    found = refused(monkeypatch, capsys, config, "--every", "5")
    assert found.startswith("error: PREFECT_API_URL http://127.0.0.1:9/api: no Prefect server")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--cron", "0 3 * *"), "--cron: found '0 3 * *', expected five fields as in '0 3 * * *'"),
        (("--every", "0"), "--every: found 0, expected a number of seconds above 0"),
        (("--every", "5", "--cron", "0 3 * * *"), "--every and --cron are two ways; choose one"),
        (("--every", "5", "--steps", "0"), "steps: found 0"),
    ],
)
def test_times_that_are_none_are_refused(config, monkeypatch, capsys, arguments, expected):
    assert expected in refused(monkeypatch, capsys, config, *arguments)


def test_the_deployment_of_the_repository_can_be_loaded():
    known = yaml.safe_load((ROOT / "prefect.yaml").read_text())
    (deployment,) = known["deployments"]
    file, name = deployment["entrypoint"].split(":")
    loaded = load_flow_from_entrypoint(f"{ROOT / file}:{name}")
    from flows.schedule import scheduled

    assert loaded.name == scheduled.name
    parameters = inspect.signature(scheduled.fn).parameters
    assert deployment["parameters"].keys() <= parameters.keys()
    for schedule in deployment["schedules"]:
        CronSchedule(**schedule)
    # What the served flow is found by, in a process that knows no path of this one.
    assert getattr(import_module(scheduled.__module__), scheduled.__name__) is scheduled


def test_what_stops_a_run_is_said_and_fails_it(config, server, capsys):
    from flows.schedule import scheduled

    with pytest.raises(InputError, match="holds no chunk"):
        scheduled(str(config), {})
    assert "holds no chunk (.torch)" in capsys.readouterr().err


def test_the_scheduler_of_the_server_can_plan_runs(server):
    """Of some versions of its dependencies it cannot, and then no schedule ever fires."""
    flow = asked(server, "flows/", {"name": "planned"})
    schedule = {"active": True, "schedule": {"interval": 3600}}
    given = {"name": "planned", "flow_id": flow["id"], "schedules": [schedule]}
    made = asked(server, "deployments/", given)
    asked(server, f"deployments/{made['id']}/schedule", {})
    found = {"deployments": {"id": {"any_": [made["id"]]}}}
    runs = asked(server, "flow_runs/filter", found)
    assert len(runs) >= 1 and runs[0]["state_type"] == "SCHEDULED"


def asked(server, path: str, given: dict):
    """What the server answers; asked again while its database is locked, which 503 may mean."""
    for _ in range(20):
        answer = httpx.post(f"{server.url}/{path}", json=given, timeout=60)
        if answer.status_code != 503:
            break
        time.sleep(0.5)
    assert answer.is_success, f"{path}: {answer.status_code} {answer.text}"
    return answer.json()
