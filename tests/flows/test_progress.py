"""Progress of a run: permanent lines, counts, and the status below them in a terminal."""

import io
import itertools

import pytest

from flows.runners.progress import Progress
from tasks.context import StageEvent


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")


def report_two_scenes_and_a_failure(progress: Progress) -> None:
    """Report scenes a (cached) and b through two stages, c as left out, and d as begun."""
    for scene, stage in itertools.product("ab", ("ingest", "masks")):
        progress.update(StageEvent(scene, stage, "running"))
        state = "cached" if scene == "a" else "completed"
        progress.update(StageEvent(scene, stage, state, seconds=2.0))
    progress.update(StageEvent("c", "ingest", "failed", "too dark"))
    progress.update(StageEvent("d", "ingest", "running", "half of it"))


def test_a_stream_that_is_no_terminal_gets_lines_only():
    stream = io.StringIO()
    with Progress(4, 2, stream=stream) as progress:
        report_two_scenes_and_a_failure(progress)
    *lines, last = stream.getvalue().splitlines()
    assert lines == [
        "a  2 stages cached",
        "b  ingest 2.0 s · masks 2.0 s",
        "c  left out at ingest: too dark",
    ]
    assert last.startswith("2/4 scenes, 1 failed, ") and last.endswith(" s in all")


@pytest.mark.parametrize(("stream", "lines"), [(io.StringIO(), 1), (Terminal(), 0)])
def test_a_long_stage_without_a_terminal_gives_a_sign_of_life(stream, lines, monkeypatch):
    now = 0.0
    monkeypatch.setattr("time.perf_counter", lambda: now)
    progress = Progress(1, 1, stream=stream)
    for now in range(0, 60, 20):
        progress.update(StageEvent("branch", "train", "running", f"step {now}"))
    assert stream.getvalue() == lines * "branch: train (step 40)\n"


def test_a_terminal_shows_counts_and_what_is_worked_on():
    stream = Terminal()
    with Progress(4, 2, stream=stream) as progress:
        report_two_scenes_and_a_failure(progress)
        assert (progress.steps, progress.total) == (4, 6)
        progress.bar.refresh()
        assert "2/4 scenes, 1 failed, " in stream.getvalue()
        assert "d: ingest (half of it)" in stream.getvalue()
    assert "b  ingest 2.0 s · masks 2.0 s" in stream.getvalue()
    # It draws on its own stream and leaves the cursor where it was, and visible.
    assert stream.getvalue().count("\x1b[?25l") == stream.getvalue().count("\x1b[?25h") == 1


def test_line_escapes_control_characters_and_markup():
    stream = Terminal()
    with Progress(1, 1, stream=stream) as progress:
        progress.line("bad \x1b[31m [red]name[/red] :smile:")
    assert "bad \\x1b[31m [red]name[/red] :smile:" in stream.getvalue()


def test_lost_scenes_count_once():
    progress = Progress(2, 2, stream=io.StringIO())
    progress.update(StageEvent("a", "ingest", "completed"))
    progress.update(StageEvent("a", "masks", "completed"))
    progress.lost("died (killed)", ["a"])
    assert (progress.done, progress.steps, progress.total) == (0, 0, 4)
    for scene, stage, state in (
        ("a", "ingest", "completed"),
        ("a", "masks", "completed"),
        ("b", "ingest", "completed"),
    ):
        progress.update(StageEvent(scene, stage, state))
    progress.update(StageEvent("b", "masks", "failed", "its worker died"))
    assert (progress.done, progress.failed, progress.steps, progress.total) == (1, 1, 3, 3)
    assert "a worker died (killed)" in progress.console.file.getvalue()
