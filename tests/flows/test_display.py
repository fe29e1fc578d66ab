"""What is drawn on a terminal: whole lines above, and one table that is always the last."""

import io
import itertools
import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from flows.runners.display import Display, cut, wrapped
from flows.runners.memory import memory_in_use
from flows.runners.metrics import Metrics, duration, size
from flows.runners.progress import Progress
from tasks.events import Failed, Finished, Started

words = st.text(st.sampled_from("ab室é"), max_size=12)
texts = st.text(st.sampled_from("ab 室é\x1b\n"), max_size=12)


class Terminal(io.StringIO):
    """Obeys the few codes that are used; ``rows`` is what is to be seen."""

    def isatty(self) -> bool:
        return True

    @property
    def rows(self) -> list[str]:
        rows, row = [""], 0
        text = self.getvalue().replace("\x1b[2m", "").replace("\x1b[0m", "")
        parts = iter(text.replace("\r", "\0\r\0").replace("\n", "\0\n\0").split("\0"))
        for part in parts:
            while part.startswith("\x1b["):
                code, part = part[2:].split("A", 1) if "A" in part[:5] else ("J", part[3:])
                if code == "J":
                    del rows[row + 1 :]
                    rows[row] = ""
                else:
                    row -= int(code)
            if part == "\n":
                row += 1
                rows += [""] * (row == len(rows))
            elif part != "\r":
                rows[row] += part
        return rows


@pytest.fixture(autouse=True)
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("LINES", "20")
    monkeypatch.setenv("TERM", "xterm")


def test_lines_stay_and_the_table_is_below_them():
    seen = Terminal()
    display = Display(seen)
    for count in range(1, 4):
        cells = [(f"number {k}", str(count)) for k in range(count * 2)]
        display.table(cells, "working")
        display.line(f"line {count}")
    display.table([("done", "3")], "room: masks \x1b[31m and more than there is room for")
    assert seen.rows == [
        "line 1", "line 2", "line 3", "done", "3", "room: masks \\x1b[31m and more than the…"
    ]  # fmt: skip
    display.clear()
    assert seen.rows == ["line 1", "line 2", "line 3", ""]


@given(st.lists(st.tuples(words, words), min_size=1, max_size=9), st.integers(1, 60))
def test_no_row_is_wider_than_there_is_room_unless_a_cell_is(cells, width):
    rows = wrapped(cells, width)
    widest = max(7, *(cell_len(text) for cell in cells for text in cell))
    assert all(cell_len(text) <= max(width, widest) for row in rows for text in row)
    for side in (0, 1):
        joined = "".join(row[side] for row in rows)
        assert joined.replace(" ", "") == "".join(cell[side] for cell in cells)


@given(texts, st.integers(1, 30))
def test_what_is_cut_fits_and_obeys_nothing(text, width):
    found = cut(text, width)
    assert cell_len(found) <= width
    assert not {"\x1b", "\n"} & set(found)


def test_a_stream_that_is_no_terminal_gets_lines_only(monkeypatch):
    seen = io.StringIO()
    told = Progress(2, 1, stream=seen)
    told.hear(Started("a", "masks"))
    told.hear(Finished("a", "masks", 1.0, cached=False))
    told.display.clear()
    assert seen.getvalue() == "a  masks 1.0 s\n"
    monkeypatch.setenv("TERM", "dumb")
    assert not Display(Terminal()).live


def test_progress_keeps_one_table_of_a_run(monkeypatch):
    monkeypatch.setattr("flows.runners.progress.REDRAW", 0.0)
    seen = Terminal()
    with Progress(3, 2, stream=seen) as told:
        for scene, stage in itertools.product("ab", ("ingest", "masks")):
            told.hear(Started(scene, stage))
            told.hear(Finished(scene, stage, 2.0, cached=scene == "a"))
        told.hear(Failed("c", "ingest", "too dark"))
        told.hear(Started("d", "ingest"))
        assert seen.rows[:3] == [
            "a  2 stages cached", "b  ingest 2.0 s · masks 2.0 s",
            "c  left out at ingest: too dark"
        ]  # fmt: skip
        assert seen.rows[3].split() == ["scenes", "failed", "a", "minute", "left"]
        assert seen.rows[4].startswith("2 of 3   1  ")
        assert seen.rows[-1] == "d: ingest"
    assert len(seen.rows) == 4 and seen.rows[3] == ""


def test_what_is_dropped_is_counted_once():
    told = Progress(2, 2, stream=io.StringIO())
    for _ in range(2):
        for stage in ("ingest", "masks"):
            told.hear(Finished("a", stage, 1.0, cached=False))
        told.hear(Finished("b", "ingest", 1.0, cached=False))
        told.hear(Failed("b", "masks", "its worker died"))
        found = told.metrics()
        assert (found.done, found.failed, found.steps, found.stages) == (1, 1, 3, 3)
        told.dropped("a")
        told.dropped("b")
        found = told.metrics()
        assert (found.done, found.failed, found.steps, found.stages) == (0, 0, 0, 4)


def test_metrics_say_the_same_in_cells_and_in_a_sentence():
    found = Metrics("chunks", 12, 2, 300, 100, 2400, 96, 4, 8.25, 6000.0, 3 << 29, 2 << 30)
    assert dict(found.cells()) == {
        "chunks": "12 of 300", "failed": "2", "a minute": "8.25", "left": "1 h 40 min",
        "computed": "96", "cached": "4", "memory": "1.5 GiB", "peak": "2.0 GiB",
    }  # fmt: skip
    assert found.sentence() == (
        "12/300 chunks, 2 failed, 100/2400 stages, 96 computed, 4 cached, 8.25 chunks a minute, "
        "about 1 h 40 min left, 1.5 GiB of memory, at most 2.0 GiB"
    )


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0, "0 s"), (99.4, "99 s"), (99.6, "2 min"), (5900, "98 min"), (2e5, "2 d 7 h")],
)
def test_durations(seconds, said):
    assert duration(seconds) == said


def test_sizes():
    assert [size(5 << 20), size(1 << 30)] == ["5 MiB", "1.0 GiB"]


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="asks the kernel in /proc")
def test_memory_is_that_of_children_too():
    code = "import sys; held = b'1' * (200 << 20); print(1, flush=True); sys.stdin.read()"
    before = memory_in_use()
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        child.stdout.readline()
        during = memory_in_use()
    assert during - before > 190 << 20
    assert memory_in_use() - before < 100 << 20
