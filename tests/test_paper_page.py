"""The page of the paper is what its table says, and what the table names exists."""

import ast
import shlex
import sys
from pathlib import Path

import pytest
import typer

from flows.cli.app import app

DOCS = Path(__file__).parents[1] / "docs"
sys.path.insert(0, str(DOCS))
import make_paper  # noqa: E402

ROWS = [row for section in make_paper.rows().values() for row in section]
COMMANDS = typer.main.get_command(app).commands


def test_the_page_is_what_its_maker_writes():
    assert make_paper.PAGE.read_text("utf-8") == make_paper.page()
    assert make_paper.rows().keys() == make_paper.TITLES.keys()


@pytest.mark.parametrize("place", sorted({place for row in ROWS for place in row["code"]}))
def test_what_it_names_is_in_the_code(place):
    file, _, name = place.partition(":")
    scope = ast.parse((DOCS.parent / file).read_text("utf-8")).body
    for part in name.split("."):
        names = {getattr(node, "name", ""): getattr(node, "body", []) for node in scope}
        for node in scope:
            targets = getattr(node, "targets", [getattr(node, "target", None)])
            names |= {target.id: [] for target in targets if isinstance(target, ast.Name)}
        assert part in names, place
        scope = names[part]


@pytest.mark.parametrize("command", sorted({row["command"] for row in ROWS}))
def test_its_commands_can_be_given(command):
    program, name, *words = shlex.split(command)
    options = {option for each in COMMANDS[name].params for option in each.opts}
    assert program == "slgaussian"
    assert {word for word in words if word.startswith("-")} <= options
    assert all(row["here"] in ("same", "option", "differs", "absent") for row in ROWS)
