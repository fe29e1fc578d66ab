"""The log of a run: every event is a line of JSON, and nothing that happens to it stops the run."""

import io
import json
import logging
from datetime import datetime

import pytest

from flows.runners.log_file import FILE, log, log_to_file
from flows.runners.progress import Progress
from slgaussian.errors import InputError
from tasks.context import StageEvent


def lines_of(file) -> list[dict]:
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]


def run_one(verbose: bool = False) -> Progress:
    """Two scenes of two stages, of which one is left out."""
    with Progress(2, 2, stream=io.StringIO(), verbose=verbose) as progress:
        for stage, state in (("ingest", "cached"), ("masks", "completed")):
            progress.update(StageEvent("küche\n", stage, "running"))
            progress.update(StageEvent("küche\n", stage, state, seconds=0.5))
        progress.lost(True, "died (killed)", ["hall"])
        progress.update(StageEvent("hall", "ingest", "running"))
        progress.update(StageEvent("hall", "ingest", "completed", seconds=0.25))
        progress.update(StageEvent("hall", "ingest", "repeated"))
        progress.update(
            StageEvent("hall", "masks", "failed", "a defect", traceback="Traceback: of it")
        )
    return progress


def test_every_event_has_its_line(tmp_path):
    with log_to_file(tmp_path, command="run", workers=2):
        run_one()
    first, *events, last = lines_of(tmp_path / FILE)
    assert first["event"] == "run" and first["command"] == "run" and first["workers"] == 2
    assert [event["event"] for event in events] == [
        "began", "finished", "done", "worker_died", "finished", "repeated", "failed", "progress",
    ]  # fmt: skip
    assert (last["event"], last["how"]) == ("ended", "finished")
    full = [first, *events, last]
    times = [datetime.fromisoformat(line["time"]) for line in full]
    assert times == sorted(times) and all(str(time.tzinfo) == "UTC" for time in times)
    output = {line["event"]: line for line in events}
    assert output["done"]["scene"] == "küche\n" and output["done"]["cached"] == 1
    assert (
        output["failed"]["level"] == "error" and output["failed"]["traceback"] == "Traceback: of it"
    )
    assert output["worker_died"]["scenes"] == ["hall"]
    assert (output["progress"]["done"], output["progress"]["failed"]) == (1, 1)


def test_it_says_how_the_run_ended(tmp_path):
    ends = [
        (InputError("no such folder"), "refused", "no such folder"),
        (ZeroDivisionError("a defect"), "failed", "unexpected ZeroDivisionError: a defect"),
        (KeyboardInterrupt(), "stopped", "stopped"),
    ]
    for error, how, message in ends:
        with pytest.raises(type(error)), log_to_file(tmp_path):
            log(logging.INFO, "note", "begun")
            raise error
        last = lines_of(tmp_path / FILE)[-1]
        assert (last["event"], last["how"], last["message"]) == ("ended", how, message)
        assert ("traceback" in last) == (how == "failed")


def test_a_log_that_cannot_be_written_is_said_once(tmp_path, capsys):
    with log_to_file(tmp_path / "gone"):
        output = run_one()
    assert output.done == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert f"{FILE}: cannot be written (No such file or directory); going on without" in text
