"""Modules that commands import: heavy ones only where they are needed."""

import json
import subprocess
import sys

import pytest
from command import two_walls

HEAVY = {
    "torch", "numba", "scipy", "skimage", "pyarrow", "prefect", "transformers", "matplotlib",
    "fsspec", "cv2", "numpy", "pydantic",
}  # fmt: skip

CODE = """
import json, sys
sys.argv = ["slgaussian", *json.loads(sys.argv[1])]
from flows.cli.app import main
try:
    main()
finally:
    print(json.dumps(sorted(sys.modules)), file=sys.stderr)
"""


def import_modules(*words: str) -> tuple[str, set[str]]:
    """Run ``slgaussian WORDS`` in a new process; return output and heavy modules loaded."""
    inputs = [sys.executable, "-c", CODE, json.dumps(words)]
    done = subprocess.run(inputs, capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr  # what is asked for may not be there
    return done.stdout, HEAVY & set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.parametrize("words", [("--help",), ("words",), ("--version",)], ids=" ".join)
def test_what_needs_no_array_loads_none(words):
    assert import_modules(*words)[1] <= {"pydantic"}  # by which Typer reads options


def test_the_help_of_a_command_loads_no_kernel_and_no_network():
    assert import_modules("query", "--help")[1] <= {"numpy", "pydantic"}


def test_a_list_of_versions_waits_for_no_pictures(tmp_path):
    assert not import_modules("versions", str(tmp_path))[1] & {"cv2", "scipy", "torch"}


def test_a_question_waits_for_no_torch_and_once_asked_for_no_kernel_either(tmp_path, monkeypatch):
    monkeypatch.setenv("SLGAUSSIAN_CACHE", str(tmp_path / "cache"))
    two_walls(tmp_path / "field")
    question = ("query", str(tmp_path / "field"), "red", "--json")
    first, heavy = import_modules(*question)
    assert "torch" not in heavy and "pyarrow" not in heavy
    rerun, heavy = import_modules(*question)
    assert rerun == first and json.loads(first)["text"] == "red"
    assert heavy == {"numpy", "cv2", "pydantic"}


LOGGED = """
import sys
from pathlib import Path
from flows.runners.environment import prepare
prepare(Path(sys.argv[1]))
import prefect
prefect.logging.get_logger("flow_runs").info("a line")
"""


def test_lines_of_prefect_stay_off_the_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("PREFECT_LOGGING_LEVEL", "INFO")
    monkeypatch.delenv("PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL", raising=False)
    command = [sys.executable, "-c", LOGGED, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout + done.stderr == ""
