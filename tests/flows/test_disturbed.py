"""Runs beside other runs on one store, on a full disk, and without their server."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from process_family import PROC, below
from tiny_program import HERE, first_words, start, wait_until, with_database
from tiny_run import run_tiny, three_scenes

from benches.common.bad_weather import BadWeather
from slgaussian.storage import remote
from slgaussian.storage.store import ArtifactStore

pytestmark = pytest.mark.usefixtures("server")

NAMESPACE = ["unshare", "--user", "--map-root-user", "--mount"]
"""A program begun with these may mount disks that nobody else sees."""


@pytest.fixture(scope="module")
def complete(server, tmp_path_factory):
    """Return the refs of an undisturbed run."""
    folder = tmp_path_factory.mktemp("whole")
    return run_tiny(ArtifactStore(folder / "store"), three_scenes(folder / "log")).refs


def check_nothing_is_left_to_do(store: Path, log: Path, complete: dict) -> None:
    assert not [p for p in store.rglob("*.tmp") if ".prefect" not in p.parts]
    before = log.read_text()
    assert run_tiny(ArtifactStore(store), three_scenes(log)).refs == complete
    assert log.read_text() == before


def test_two_runs_on_one_store_at_once(tmp_path, home, server, complete):
    store, log = with_database(tmp_path / "store", server), tmp_path / "log"
    both = [start(home, store, log, 0.5, runner) for runner in ("threads", "processes")]
    for process in both:
        _, messages = process.communicate(timeout=120)
        assert process.returncode == 0, messages.decode()
        assert first_words(messages) == ["scene_0", "scene_1", "scene_2"]
    done = log.read_text().splitlines()
    assert len(set(done)) == 9 and len(done) <= 18
    check_nothing_is_left_to_do(store, log, complete)


def test_a_bucket_whose_server_has_a_bad_day(
    tmp_path, server, complete, bucket, s3_server, monkeypatch
):
    """`benches/pipeline/storm.py` has it in full, with kills, damage and a full disk."""
    s3fs = pytest.importorskip("s3fs")
    calm, log = ArtifactStore(tmp_path / "calm"), tmp_path / "log"
    run_tiny(calm, three_scenes(log))
    weather = BadWeather(s3_server, 0.3, hang=1.5)
    monkeypatch.setenv("AWS_ENDPOINT_URL", weather.url)
    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")
    monkeypatch.setattr(remote, "READ_TIMEOUT", 1)
    s3fs.S3FileSystem.clear_instance_cache()
    try:
        store = ArtifactStore(f"{bucket}/slg")
        outcome = run_tiny(store, three_scenes(tmp_path / "other log"))
        assert outcome.failures == [] and outcome.refs == complete
        weather.share = 0.0
        result = {file.uri for files in store.walk(["labels"]) for file in files}
        assert result == {file.uri for files in calm.walk(["labels"]) for file in files}
        assert all(store.read(uri) == calm.read(uri) for uri in result)
        assert weather.met.total() - weather.met[""] >= 5
    finally:
        weather.close()
        s3fs.S3FileSystem.clear_instance_cache()


def test_a_disk_that_fills_stops_the_run_and_the_next_one_completes_it(tmp_path, server, complete):
    try:
        subprocess.run([*NAMESPACE, "true"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"needs to mount a small disk: {error}")
    disk = tmp_path / "disk"
    disk.mkdir()
    command = [*NAMESPACE, sys.executable, HERE / "full_disk.py", disk]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent.parent)])}
    run = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    full, part, room = json.loads(run.stdout)
    for stopped in (full, part):
        assert "(No space left on device); make room there" in stopped["stopped"]
    assert room["stopped"] == ""
    wanted = {s: {stage: r.digest for stage, r in output.items()} for s, output in complete.items()}
    assert room["refs"] == wanted
    for report in (full, part, room):
        assert report["unfinished"] == []


@pytest.mark.skipif(not (PROC / "self/stat").exists(), reason="asks the kernel in /proc")
def test_work_goes_on_without_the_server_of_a_run(tmp_path, home, server, complete):
    store, log = with_database(tmp_path / "store", server), tmp_path / "log"
    retries = {"PREFECT_CLIENT_MAX_RETRIES": "0"}  # each takes many seconds
    process = start(home, store, log, 0.7, "threads", **retries)
    assert wait_until(lambda: log.exists() and "scene_1 make" in log.read_text(), 120)
    lines = {number: (PROC / f"{number}/cmdline").read_bytes() for number in below(process.pid)}
    (itself,) = [number for number, line in lines.items() if b"flows.runners.server" in line]
    os.kill(itself, signal.SIGKILL)
    _, messages = process.communicate(timeout=120)
    assert process.returncode == 0, messages.decode()
    check_nothing_is_left_to_do(store, log, complete)
