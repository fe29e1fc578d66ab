"""Help, completion and spelling suggestions of the command line."""

import inspect
import os
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from command import run
from typer.main import get_command

from flows import config
from flows.cli.app import app
from flows.cli.options import settings_from

ROOT = Path(__file__).parents[2]
ROOT_COMMAND = get_command(app)
COMMANDS = {
    (name, *extra): command
    for name, first in ROOT_COMMAND.commands.items()
    for extra, command in (
        {(inner,): c for inner, c in first.commands.items()} if hasattr(first, "commands") else {
            (): first
        }
    ).items()
}  # fmt: skip
"""Every command by its words, such as ``("store", "gc")``."""
GROUPS = [(), *dict.fromkeys(words[:-1] for words in COMMANDS if len(words) > 1)]
EACH = pytest.mark.parametrize("words", COMMANDS, ids=" ".join)


@pytest.fixture
def visible(monkeypatch, capsys):
    """Run ``slgaussian WORDS`` in a terminal of ``columns`` columns; return the output."""

    def visible(*words: str, columns: int = 80) -> str:
        # click's own variable: there is no terminal to ask here.
        monkeypatch.setenv("COLUMNS", str(columns))
        assert run(monkeypatch, *words) == 0
        return capsys.readouterr().out

    return visible


@EACH
def test_help_is_one_screen_with_examples_and_every_option(words, visible):
    text = visible(*words, "--help", columns=100)
    lines = text.splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 100
    assert "Undefined" not in text and "None" not in text
    assert visible(*words, "-h", columns=100) == text
    options = {param.opts[0] for param in COMMANDS[words].params}
    assert not [name for name in options if name.startswith("--") and name not in text]


@pytest.mark.parametrize("words", GROUPS, ids=lambda words: " ".join(words) or "slgaussian")
def test_the_help_of_a_group_is_one_screen_of_whole_sentences(words, visible):
    text = visible(*words, "--help")
    assert len(text.splitlines()) <= 42 and max(map(len, text.splitlines())) <= 80
    assert "..." not in text.replace("[ARGS]...", "")
    assert visible(*words, "-h") == text


@pytest.mark.parametrize(
    ("assignments", "expected"),
    [
        (["near=1"], {"near": 1}),
        (["near=.5", "size=at most 96x128"], {"near": ".5", "size": "at most 96x128"}),
        (["sam.model=a/b=c", "sam.points=8"], {"sam": {"model": "a/b=c", "points": 8}}),
        (['queries=["red", "a, b"]', "trust_cameras=true"],
         {"queries": ["red", "a, b"], "trust_cameras": True}),
        (['method="1"', "method2=1\n2"], {"method": "1", "method2": "1\n2"}),
    ],
)  # fmt: skip
def test_assignments_are_values_of_a_configuration(assignments, expected):
    ctx = SimpleNamespace(params={"set_": assignments, "seed": 3, "preset": None})
    assert settings_from(ctx, out=None) == {**expected, "seed": 3}


@EACH
def test_every_example_is_understood(words):
    """Checked without running: names, options and their types."""
    doc = inspect.cleandoc(COMMANDS[words].help).replace("\\\n", " ")
    examples = [line for line in map(str.strip, doc.splitlines()) if line.startswith("slgaussian ")]
    assert examples
    for line in examples:
        calls = shlex.split(line)[1:]
        at = 2 if tuple(calls[:2]) in COMMANDS else 1
        command = COMMANDS[tuple(calls[:at])]
        with typer.Context(ROOT_COMMAND, info_name="slgaussian") as above:
            command.make_context(" ".join(calls[:at]), calls[at:], parent=above)
    assert any(line.split()[1 : len(words) + 1] == list(words) for line in examples)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("slgaussian fie", {"field"}),
        ("slgaussian field --predictor ", {"planesweep", "mvsplat", "precomputed", "gaussians"}),
        ("slgaussian demo --preset ", set(config.PRESETS)),
        ("slgaussian objects ", {"list", "teach", "name", "remove", "extract"}),
        ("slgaussian query fie", set()),  # left to the shell: a folder
    ],
)
def test_completion_knows_commands_options_and_names(line, expected, monkeypatch, capsys):
    """As the scripts of bash ask; ``--show-completion`` prints them."""
    monkeypatch.setenv("_SLGAUSSIAN_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split()) - (not line.endswith(" "))))
    assert run(monkeypatch) == 0
    assert set(capsys.readouterr().out.split()) == expected


def test_completion_and_help_need_no_heavy_library():
    code = (
        "import sys\nfrom flows.cli.app import main\ntry: main()\nexcept SystemExit: pass\n"
        "heavy = {'torch', 'prefect', 'numba', 'cv2'} & set(sys.modules)\n"
        "sys.exit(f'loaded: {heavy}' if heavy else 0)"
    )
    calls = {"COMP_WORDS": "slgaussian field --encoder ", "COMP_CWORD": "3"}
    env = {**os.environ, **calls, "_SLGAUSSIAN_COMPLETE": "complete_bash"}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=env, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [b"lexicon", b"clip"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("feild", "Did you mean 'field'?"),
        ("demo --encodr clip", "--encoder"),
        ("field", "PHOTO"),
        ("demo --workers two", "--workers"),
        ("doctor red", "red"),
        ("demo --set codes=seperated", "; did you mean 'separated'?"),
        ("benchmark --rooms 0-0 --against langsplatlike", "; did you mean 'langsplat-like'?"),
        ("demo --set seed", "--set: found 'seed', expected KEY=VALUE, as planesweep"),
        ("demo --seed 1 --set seed=2", "--set: seed is given twice"),
        ("demo --set sam.point=4", "unknown key 'sam.point'; did you mean 'points'?"),
        ("demo --set lifting=branch", "no weights are given; train some"),
    ],
)
def test_a_slip_is_named_with_the_nearest_name(line, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *line.split()) == 2
    assert expected in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == []
