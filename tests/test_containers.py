"""The container recipe, which is not built here, matches the repository."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import yaml
from prefect.flows import load_flow_from_entrypoint

ROOT = Path(__file__).parents[1]
DOCKER = ROOT / "docker"
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
SERVICES = COMPOSE["services"]


def read_instructions() -> list[tuple[str, str]]:
    """Instructions of the Dockerfile with their words, lines that go on joined."""
    lines = (DOCKER / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    return [
        (line.split()[0], line.split(maxsplit=1)[1])
        for line in lines
        if line.strip() and not line.startswith("#")
    ]


def list_copied_paths() -> set[str]:
    return {
        path for kind, rest in read_instructions() if kind == "COPY" for path in rest.split()[:-1]
    }


def test_image_copies_existing_files():
    ignored = (DOCKER / "Dockerfile.dockerignore").read_text().splitlines()
    assert {line[1:] for line in ignored if line.startswith("!")} == list_copied_paths()
    assert all((ROOT / path).exists() for path in list_copied_paths())
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages - {"tests", "benches"} <= list_copied_paths()


def test_image_runs_an_installed_command_as_plain_user():
    kinds = dict(read_instructions())
    assert kinds["USER"] == "10001"
    command = json.loads(kinds["CMD"])[0]
    assert command in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert kinds["FROM"].startswith("python:3.11")
    assert re.search(r"^torch==", (ROOT / "constraints.txt").read_text(), re.MULTILINE)


def test_services_use_loopback_ports_and_known_volumes():
    for service in SERVICES.values():
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:")
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            assert source in COMPOSE["volumes"] or (DOCKER / source).exists()


def test_repository_has_no_credentials():
    variables = {name for name, _ in re.findall(r"\$\{(AWS_\w+)(:\?[^}]*)\}", yaml.dump(COMPOSE))}
    assert variables == {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"}
    examples = re.findall(r"^(\w+)=(.*)$", (DOCKER / ".env.example").read_text(), re.MULTILINE)
    assert variables <= {name for name, _ in examples} and not any(value for _, value in examples)
    assert ".env" in (ROOT / ".gitignore").read_text().splitlines()
    secret = {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "MINIO_ROOT_USER"}
    for service in SERVICES.values():
        for name, value in service.get("environment", {}).items():
            assert name not in secret or value.startswith("${")


DEPLOYMENTS = yaml.safe_load((DOCKER / "prefect.yaml").read_text())["deployments"]


@pytest.mark.parametrize("deployment", DEPLOYMENTS, ids=[d["name"] for d in DEPLOYMENTS])
def test_deployment_parameters_are_valid_and_in_the_volumes(deployment):
    flow = load_flow_from_entrypoint(deployment["entrypoint"])
    config = flow.validate_parameters(deployment["parameters"])["config"]
    assert config.store == "s3://slgaussian/store" and str(config.out).startswith("/data/")
