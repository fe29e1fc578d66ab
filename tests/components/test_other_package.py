"""Components of other packages, by entry point, work like built-in ones."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slgaussian.io import file_digest
from tests.flows.command import ROOM, room_sample, save_photographs

ROOT = Path(__file__).parents[2]
PACKAGE = Path(__file__).parent / "other_package"
RED = "200 40 40\n"


@pytest.fixture
def run_python(tmp_path):
    """Run a Python program with packages on its path; return its output."""

    def run_python(code: str, *packages: Path, fails: bool = False) -> str:
        places = map(str, (ROOT, *(packages or (PACKAGE,))))
        env = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
        done = subprocess.run(
            [sys.executable, "-c", code], env=env, cwd=tmp_path, capture_output=True, text=True
        )
        assert (done.returncode != 0) == fails, done.stderr
        return done.stderr if fails else done.stdout

    return run_python


def command(*words: object) -> str:
    argv = ["slgaussian", *map(str, words)]
    return f"import sys; sys.argv = {argv}\nfrom flows.cli.app import main; main()"


def package(folder: Path, name: str, line: str, code: str) -> Path:
    """Create an installed package of one module with one entry point."""
    (folder / f"{name}.dist-info").mkdir(parents=True)
    (folder / f"{name}.py").write_text(code)
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n"
    (folder / f"{name}.dist-info" / "METADATA").write_text(metadata)
    (folder / f"{name}.dist-info" / "entry_points.txt").write_text(line)
    return folder


def test_architecture_page_shows_whole_example():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    assert (PACKAGE / "ink.py").read_text("utf-8") in page


def test_plugin_is_listed_with_built_in_components(run_python):
    listed = " ".join(run_python(command("doctor", "--components")).split())
    assert "### regions (default)" in listed and "### ink" in listed
    assert "default `40.0`. Greatest distance from a colour." in listed
    schema = json.loads(run_python(command("doctor", "--schema")))
    assert schema["$defs"]["Ink"]["properties"]["within"]["maximum"] == 442


DECLARED = """
import json, pickle
from flows.config import TABLES, Settings
from flows.read_config import make_settings
from slgaussian.components.registry import find_config
from tasks.stage import cache_key
config = make_settings({"proposer": "ink", "ink": {"colours": "a.txt", "least": 5}}, "test")
ink = config.field_method.proposer
assert pickle.loads(pickle.dumps(ink)) == ink == config.configure("proposer").pin()
try:
    make_settings({"proposer": "ink", "ink": {"within": 500}}, "test")
except ValueError as error:
    refused = str(error)
print(json.dumps([
    ink.kind, ink.name, ink.identity(), ink.places(), type(ink.load()).__name__, refused,
    cache_key("masks", 1, {"proposer": ink}), find_config("proposer", "ink").describe(),
    Settings.model_json_schema()["$defs"]["Ink"], sorted(TABLES),
]))
"""


def test_plugin_and_built_in_component_go_the_same_way(run_python, tmp_path):
    (tmp_path / "a.txt").write_text(RED)
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "ink.py").write_bytes((PACKAGE / "ink.py").read_bytes())
    entry = "from slgaussian.masks import configs; configs.PROPOSERS['ink'] = 'ink:Ink'"
    built_in = run_python(entry + DECLARED, tmp_path / "alone")
    assert json.loads(run_python(DECLARED)) == json.loads(built_in)


def test_file_of_plugin_is_relative_to_configuration_and_known_by_content(run_python, tmp_path):
    (tmp_path / "sub").mkdir()
    for file in ("a.txt", "sub/b.txt"):
        (tmp_path / file).write_text(RED)
    code = (
        "import json, sys; from pathlib import Path; from flows.read_config import read_toml\n"
        "for name in ('a.toml', 'sub/b.toml'):\n"
        "    ink = read_toml(Path(name), {}).configure('proposer')\n"
        "    print(json.dumps([ink.identity(), ink.places()]))"
    )
    for name, file in (("a.toml", "a.txt"), ("sub/b.toml", "b.txt")):
        text = f'proposer = "ink"\n[ink]\ncolours = "{file}"\nleast = 5\n'
        (tmp_path / name).write_text(text)
    (first, at), (second, elsewhere) = map(json.loads, run_python(code).splitlines())
    assert first == second and first["least"] == 5 and len(first["colours"]) == 64
    assert at["colours"] == str(tmp_path / "a.txt") != elsewhere["colours"]


def test_field_is_built_with_plugin(run_python, tmp_path):
    folder = save_photographs(tmp_path)
    view = room_sample().context[0]
    ids, counts = np.unique(view.instances, return_counts=True)
    colours = [np.median(view.image[view.instances == i], 0) for i in ids[counts > 30]]
    np.savetxt(tmp_path / "colours.txt", colours)
    photographs = [folder / f"{name}.png" for name in ROOM["context"]]
    options = ["--proposer", "ink", "--set", "ink.colours=colours.txt", "--set", "ink.within=60"]
    near = ["--set", "near=0.8", "--set", "far=12", "--size", "64x64", "--set", "replicas=1"]
    cameras = ["--cameras", folder / "transforms.json"]
    run_python(command("field", *photographs, *cameras, *options, *near, "-o", "field"))
    settings = json.loads((tmp_path / "field" / "field.json").read_text())["settings"]
    assert settings["proposer"] == "ink"
    digest = file_digest(tmp_path / "colours.txt")
    assert settings["ink"] == {"colours": digest, "within": 60.0, "least": 20}


@pytest.mark.parametrize("name", ["regions", "lexicon"])
def test_plugin_with_name_of_built_in_component_raises_input_error(run_python, tmp_path, name):
    folder = package(
        tmp_path / "p",
        "mine",
        f"[slgaussian.proposers]\n{name} = mine:Regions\n",
        "class Regions: ...",
    )
    printed = run_python(
        "from slgaussian.components.registry import find_config\n"
        "from slgaussian.errors import InputError\n"
        f"try: find_config('proposer', {name!r})\nexcept InputError as error: print(error)",
        folder,
    )
    assert printed.startswith(f"proposer '{name}': a component of this name is built in")


def test_plugin_that_cannot_be_imported_raises_input_error_with_its_name(run_python, tmp_path):
    line = "[slgaussian.encoders]\nbroken = broken:Encoder\n"
    folder = package(tmp_path / "p", "broken", line, "import nothing_of_this_name\n")
    listed = run_python(command("doctor", "--components"), folder).splitlines()
    problem = listed[listed.index("### broken") + 2]
    assert problem.startswith("encoder 'broken': broken:Encoder of the package broken cannot be ")
    message = run_python(
        "from slgaussian.language import load_encoder\n"
        "from slgaussian.errors import InputError\n"
        "try: load_encoder('broken')\nexcept InputError as error: print(error)",
        folder,
    )
    assert message.strip() == problem
