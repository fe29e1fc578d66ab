"""The notebook runs from its first cell to its last."""

from pathlib import Path

import pytest

pytestmark = pytest.mark.whole

nbformat = pytest.importorskip("nbformat", reason="needs nbclient and ipykernel: the extra `test`")
nbclient = pytest.importorskip("nbclient", reason="needs nbclient and ipykernel: the extra `test`")

NOTEBOOK = Path(__file__).parents[1] / "docs" / "two_photographs.ipynb"

ANSWERED = """
red, green, blue = view.rgb[hit.mask].mean(0)
assert red > 1.5 * max(green, blue), (red, green, blue)
assert 0.01 < hit.mask.mean() < 0.25 and hit.score > 0.5 and hit.mask[hit.point[1], hit.point[0]]
assert set(np.unique(labels)) >= {1, 2, 3, 4}
"""
"""Of the motorcycle, "red" lights up its tank and mudguards, and the box behind."""


def count_pictures(cell: dict) -> int:
    return sum("image/jpeg" in output.get("data", {}) for output in cell.get("outputs", []))


def test_notebook_runs_and_answers(tmp_path):
    stored = nbformat.read(NOTEBOOK, as_version=4)
    book = nbformat.read(NOTEBOOK, as_version=4)
    book.cells.append(nbformat.v4.new_code_cell(f"import numpy as np\n{ANSWERED}"))
    place = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(book, timeout=600, startup_timeout=300, resources=place).execute()
    # The pictures that readers see without running it are still those that it draws.
    assert [count_pictures(cell) for cell in book.cells[:-1]] == [
        count_pictures(cell) for cell in stored.cells
    ]
    assert sum(map(count_pictures, book.cells)) >= 4
    assert (tmp_path / "field" / "field.json").is_file()


def test_notebook_is_small_enough_for_a_forge():
    assert NOTEBOOK.stat().st_size < 300_000
