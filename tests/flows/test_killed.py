"""Stopped runs lose nothing, repeat nothing, and leave no process."""

import os
import signal
from pathlib import Path

import pytest
from process_family import LOOPBACK, PROC, below, listening, living
from tiny_program import first_words, start, wait_until, with_database
from tiny_run import run_tiny, three_scenes

from slgaussian.storage.store import ArtifactStore

FOREVER = 3600.0
"""Seconds that the stage at hand would take."""

pytestmark = [
    pytest.mark.skipif(not (PROC / "self/stat").exists(), reason="asks the kernel in /proc"),
    pytest.mark.usefixtures("server"),
]


@pytest.mark.parametrize(
    ("runner", "number", "everyone"),
    [
        ("threads", signal.SIGKILL, False),
        ("processes", signal.SIGINT, True),  # Ctrl-C: a terminal sends it to all processes
    ],
)
def test_a_stopped_run_goes_on_later_and_leaves_nothing(
    tmp_path, home, server, runner, number, everyone
):
    store, log = with_database(tmp_path / "store", server), tmp_path / "log"
    process = start(home, store, log, FOREVER, runner)
    # The second scene is being worked on, so the first is done and recorded.
    assert wait_until(lambda: log.exists() and "scene_1 make" in log.read_text(), 120)
    begun = below(process.pid)
    assert len(begun) >= 1
    places = [place for pid in (process.pid, *begun) for place in listening(pid)]
    assert places and all(address.partition(":")[0] in LOOPBACK for _, address in places)

    if everyone:
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    # Its output are pipes: a process left behind would hold them open.
    _, messages = process.communicate(timeout=60)
    assert process.returncode == -number
    wait_until(lambda: not living(begun), 30)
    assert living(begun) == []
    assert left_in(home) == []
    if number != signal.SIGKILL:
        assert first_words(messages) == ["scene_0", "stopped"]

    before = log.read_text().splitlines()
    outcome = run_tiny(ArtifactStore(store), three_scenes(log))
    after = log.read_text().splitlines()[len(before) :]
    assert sorted(outcome.refs) == ["scene_0", "scene_1", "scene_2"]
    assert not any(line.startswith("scene_0") for line in after)
    assert not [p for p in store.rglob("*.tmp") if ".prefect" not in p.parts]
    full = run_tiny(ArtifactStore(tmp_path / "other"), three_scenes(tmp_path / "other log"))
    assert full.refs == outcome.refs


def left_in(home: Path) -> list[str]:
    """List files of a folder except caches, or of shared memory except other programs'."""
    theirs = ("sem.", "faketime_")
    shared = [p.name for p in Path("/dev/shm").iterdir() if not p.name.startswith(theirs)]
    return shared + [p.name for p in home.iterdir() if p.name != ".cache"]
