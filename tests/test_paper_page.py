"""The page of the paper is what its table says, and the code that it names exists.

Its commands are checked with those of all pages, in ``test_docs.py``.
"""

import ast
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
sys.path.insert(0, str(DOCS))
import make_paper  # noqa: E402

ROWS = [row for section in make_paper.rows().values() for row in section]


def test_paper_page_equals_its_table():
    assert make_paper.PAGE.read_text("utf-8") == make_paper.page()
    assert make_paper.rows().keys() == make_paper.TITLES.keys()
    assert {row["here"] for row in ROWS} == {"same", "option", "differs", "absent"}


@pytest.mark.parametrize("place", sorted({place for row in ROWS for place in row["code"]}))
def test_paper_page_names_existing_code(place):
    file, _, name = place.partition(":")
    scope = ast.parse((DOCS.parent / file).read_text("utf-8")).body
    for part in name.split("."):
        names = {getattr(node, "name", ""): getattr(node, "body", []) for node in scope}
        for node in scope:
            targets = getattr(node, "targets", [getattr(node, "target", None)])
            names |= {target.id: [] for target in targets if isinstance(target, ast.Name)}
        assert part in names, place
        scope = names[part]
