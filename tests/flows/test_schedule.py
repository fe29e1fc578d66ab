"""Schedules: what they need is said at once, and what the files promise can be loaded.

That they fire is shown by ``benches/pipeline/scheduled_retraining.py``: a server, and two times of
a clock.
"""

import inspect
import logging
import os
import re
import shlex
import shutil
import subprocess
import sys
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
    file = tmp_path / "night.toml"
    file.write_text(f'chunks = "{tmp_path}"\nout = "corpus"\nmodels = "models"\nstore = "store"\n')
    return file


def refused(monkeypatch, capsys, *arguments) -> str:
    assert run(monkeypatch, "nightly", *arguments) == 2
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
        (("--every", "5", "--set", "steps=0"), "steps: found 0"),
    ],
)
def test_times_that_are_none_are_refused(config, monkeypatch, capsys, arguments, expected):
    assert expected in refused(monkeypatch, capsys, config, *arguments)


DEPLOYMENTS = yaml.safe_load((ROOT / "prefect.yaml").read_text())["deployments"]


@pytest.mark.parametrize("deployment", DEPLOYMENTS, ids=[d["name"] for d in DEPLOYMENTS])
def test_the_deployments_of_the_repository_can_be_loaded(deployment):
    loaded = load_flow_from_entrypoint(deployment["entrypoint"])
    name = deployment["entrypoint"].rpartition(".")[2]
    from flows import schedule
    from flows.runners import journal

    own = getattr(schedule, name)
    assert loaded.name == own.name
    parameters = inspect.signature(own.fn).parameters
    assert deployment["parameters"].keys() <= parameters.keys()
    for clock in deployment.get("schedules", []):
        CronSchedule(**clock)
    pool = deployment["work_pool"]
    assert pool["name"] == "slgaussian"
    extra = pool["job_variables"]["env"]["PREFECT_LOGGING_EXTRA_LOGGERS"]
    assert logging.getLogger(extra).handlers  # where that of the runs sends what it hears
    assert journal._log.name.startswith(f"{extra}.")


def test_a_served_flow_is_found_by_its_module():
    """In a process that knows no path of this one."""
    from flows.schedule import nightly

    assert getattr(import_module(nightly.__module__), nightly.__name__) is nightly


def test_what_stops_a_run_is_said_and_fails_it(config, server, capsys):
    from flows.schedule import nightly

    with pytest.raises(InputError, match="holds no chunk"):
        nightly(str(config), {})
    assert "holds no chunk (.torch)" in capsys.readouterr().err


def test_other_configurations_are_read_like_those_of_the_commands(config, server, capsys):
    from flows.schedule import report, supervise

    with pytest.raises(InputError, match=r"night.toml: unknown key 'models'"):
        supervise(str(config))
    config.write_text(f'chunks = "{config.parent}"\nout = "corpus"\nstore = "store"\n')
    with pytest.raises(InputError, match="holds no chunk"):
        supervise(str(config), {"min_overlap": 0.5})
    with pytest.raises(InputError, match=r"min_overlap 1 is above max_overlap 0.5; no pair"):
        supervise(str(config), {"min_overlap": 1.0, "max_overlap": 0.5})
    with pytest.raises(InputError, match="unknown key 'chunks'"):
        report(str(config))
    capsys.readouterr()


def test_a_report_by_the_clock_is_that_of_the_command(tmp_path, server, capsys):
    from command import ROOM

    from flows.schedule import report

    config = tmp_path / "report.toml"
    config.write_text('out = "scores"\nstore = "store"\nsize = "64x96"\n')
    lost = {**ROOM, "name": "lost", "options": {"seed": 1, "objects": 4, "views": 1}}
    away = {**lost, "name": "away"}
    report(str(config), {"scenes": [{**ROOM, "queries": ["red ball"]}, lost, away]})
    page = tmp_path / "scores" / "report.html"
    message = f"report: {page}; left out: away, lost"
    assert page.is_file() and message in capsys.readouterr().out
    which = {"flows": {"name": {"any_": [report.name]}}, "sort": "END_TIME_DESC"}
    states = [one["state"] for one in asked(server, "flow_runs/filter", which)]
    assert [s["message"] for s in states if s["type"] == "COMPLETED"] == [message]
    first, *_, last = (tmp_path / "scores" / "log.jsonl").read_text("utf-8").splitlines()
    assert '"command": "run"' in first and '"how": "finished"' in last


LINES = (
    "prefect server start",
    "export PREFECT_API_URL=http://127.0.0.1:4200/api",
    "prefect work-pool create slgaussian --type process",
    "prefect --no-prompt deploy --all",
    "prefect worker start --pool slgaussian",
)
"""What it takes to deploy, in this order."""


def documented() -> dict[str, list[str]]:
    """The commands of every passage that deploys, without what is said of them."""
    found = {"prefect.yaml": (ROOT / "prefect.yaml").read_text("utf-8").split("\nname:")[0]}
    for page in (ROOT / "README.md", *ROOT.glob("docs/**/*.md")):
        for i, block in enumerate(page.read_text("utf-8").split("```")[1::2]):
            if "deploy --all" in block:
                found[f"{page.relative_to(ROOT)} {i}"] = block
    # Remarks stand three spaces behind the command, or behind a hash.
    return {
        name: [re.split(r" {3,}| #", line.lstrip("# "))[0].strip() for line in text.splitlines()]
        for name, text in found.items()
    }


def test_whoever_is_told_to_deploy_is_told_all_that_it_takes():
    passages = documented()
    assert len(passages) >= 3
    for name, lines in passages.items():
        assert [line for line in lines if line in LINES] == list(LINES), name


def test_the_documented_lines_deploy(server, tmp_path):
    """With the server of the tests; `benches/pipeline/deployments.py` has a worker run them."""
    shutil.copy(ROOT / "prefect.yaml", tmp_path)
    env = {**os.environ, "PREFECT_API_URL": server.url, "PREFECT_HOME": str(tmp_path / "home")}
    for line in LINES[2:4]:
        command = [sys.executable, "-m", *shlex.split(line)]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    made = {d["name"]: d["work_pool_name"] for d in asked(server, "deployments/filter", {})}
    assert made.items() >= {d["name"]: "slgaussian" for d in DEPLOYMENTS}.items()


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
