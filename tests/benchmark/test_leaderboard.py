"""What is ranked together, in which order, and what is said of what differs."""

from left import MANIFEST, leave
from pages import check_alone

from slgaussian.benchmark.leaderboard import read_leaderboard, render_leaderboard


def worse(row: dict) -> dict:
    return {**row, "iou": None if row["iou"] is None else row["iou"] * 0.5}


def first_board(*folders):
    return read_leaderboard(folders).boards[0]


def test_the_better_run_stands_first_and_what_differs_is_marked(tmp_path, result):
    other = {**MANIFEST, "settings": {"share": 0.5, "seed": 0}}
    low, high = leave(tmp_path / "low", result, worse, other), leave(tmp_path / "high", result)
    (ranking,) = first_board(high, low).rankings
    assert [(entry.rank, entry.folder.path) for entry in ranking.entries] == [
        (1, str(high)),
        (2, str(low)),
    ]
    best, last = (float(entry.cells[0].value) for entry in ranking.entries)
    assert last < best
    assert not ranking.entries[0].marks
    assert any("share 0.5 (not 0.7)" in mark for mark in ranking.entries[1].marks)


def test_equal_scores_have_one_rank(tmp_path, result):
    same = [leave(tmp_path / name, result) for name in "ab"]
    (ranking,) = first_board(*same).rankings
    assert [entry.rank for entry in ranking.entries] == [1, 1]


def test_what_was_asked_something_else_stands_apart(tmp_path, result):
    asked = sorted({row["query"] for row in result.rows})
    less = leave(
        tmp_path / "less", result, lambda row: None if row["query"] == asked[0] else worse(row)
    )
    rankings = first_board(less, leave(tmp_path / "all", result)).rankings
    assert [[entry.rank for entry in one.entries] for one in rankings] == [[1], [1]]


def test_samples_judged_at_two_sizes_are_on_two_boards(tmp_path, result):
    small = leave(tmp_path / "b", result, lambda row: {**row, "width": row["width"] // 2})
    found = read_leaderboard([leave(tmp_path / "a", result), small])
    sizes = {board.size for board in found.boards if board.protocol == "slgaussian@2"}
    assert len(sizes) == 2


def test_a_page_stands_alone_and_its_terms_are_those_of_the_first_protocol(tmp_path, result):
    html, markdown = render_leaderboard(read_leaderboard([leave(tmp_path / "a", result)]))
    check_alone(html)
    legend, _, _ = html.partition("<table")
    assert "the same, filter" not in legend  # "the same" as what?
    assert "slgaussian@2" in markdown
