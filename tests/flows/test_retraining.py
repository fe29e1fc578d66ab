"""Retraining: new clips are learnt once, withdrawn ones are not; exit statuses."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from prefect.client.orchestration import get_client

from flows import corpus
from flows.config import RetrainSettings
from flows.read_config import validate_settings
from flows.retraining import ARTIFACT, HISTORY, LOCK, PAGE, STATUS, retrain
from flows.runners.task_runners import NO_EVENTS
from slgaussian import datasets
from slgaussian.datasets import re10k
from slgaussian.kernels.seeding import held_out
from slgaussian.semantic.versions import Versions
from slgaussian.storage.locks import hold_lock

pytestmark = pytest.mark.usefixtures("server")

SHARE = 0.4
CONFIG = f"""
sources = ["chunks"]
out = "corpus"
models = "models"
store = "store"
withdrawn = "withdrawn.txt"
size = "72x96"
replicas = 1
held_out = {SHARE}
steps = 2
"""


@pytest.fixture(scope="module")
def clips():
    """Return rooms: two to train on, and one to judge by."""
    output = {True: [], False: []}
    for seed in (0, 1, 3):  # of which samples can be made
        size = {"height": 90, "width": 160}
        room = datasets.load("procedural", seed=seed, objects=4, views=6, baseline=1.0, **size)
        clip = re10k.encode_clip(room)
        output[held_out(clip.key, SHARE)].append(clip)
    return [*output[False][:2], output[True][0]]


def arrive(folder: Path, clip: re10k.Clip) -> None:
    """Write a chunk, or replace its content."""
    (folder / "chunks").mkdir(exist_ok=True)
    output = re10k.write(folder / "one", [clip], 10**8)
    (folder / "one" / output[0]).rename(folder / "chunks" / f"{clip.key.replace(' ', '_')}.torch")
    (folder / "one" / "index.json").unlink()


def record(folder: Path) -> dict:
    """Return the last row of the history."""
    return pq.read_table(folder / "models" / "history.parquet").to_pylist()[-1]


def artifact(key: str = ARTIFACT) -> str:
    """Return the latest Prefect artifact of a retraining, by the server's API."""
    with get_client(sync_client=True) as client:
        body = {"artifacts": {"key": {"any_": [key]}}, "sort": "CREATED_DESC", "limit": 1}
        answer = client._client.post("/artifacts/filter", json=body)
    (latest,) = answer.json()
    assert latest["description"]
    return latest["data"]


def read_clips(folder: Path, table: str) -> set[str]:
    return set(pq.read_table(folder / "corpus" / f"{table}.parquet")["clip"].to_pylist())


def test_retrain_records_each_outcome(clips, tmp_path, monkeypatch, slg):
    first, second, judged = clips
    monkeypatch.delenv(NO_EVENTS, raising=False)  # the server is the user's
    config = tmp_path / "night.toml"
    config.write_text(CONFIG)
    (tmp_path / "withdrawn.txt").touch()
    versions = Versions(tmp_path / "models")

    def retrain(expected: str) -> str:
        status, out, errors = slg("retrain", config)
        assert status == STATUS[expected], errors
        return out + errors

    # A first one, of too few clips to promote anything.
    for clip in (first, judged):
        arrive(tmp_path, clip)
    assert "version 1 stored, not promoted: too few clips" in retrain("refused")
    first_row = record(tmp_path)
    assert (first_row["outcome"], first_row["version"], first_row["against"]) == (
        "refused",
        1,
        None,
    )
    assert (first_row["clips"], first_row["places"]) == (2, 2)
    assert first_row["filled_iou"] > 0 and first_row["before_iou"] is None
    page = artifact()
    assert page.startswith("# Retraining: refused\n") and "](data:image/png;base64," in page
    assert (
        '<section class="" id="retrainings">' in (tmp_path / "corpus" / "report.html").read_text()
    )
    report = (tmp_path / "corpus" / "report.html").resolve()
    assert artifact(PAGE) == f"[report.html]({report.as_uri()})"

    # Nothing happens; then another one is on; then something damaged comes.
    assert "nothing new since version 1; no version is in use" in retrain("nothing new")
    with hold_lock(tmp_path / "models" / LOCK, "test"):
        assert "models is in use by another process" in retrain("busy")
    (tmp_path / "chunks" / "broken.torch").write_bytes(b"no chunk")
    assert "left out: 1, as chunks/broken.torch: " in retrain("nothing new")
    assert "chunks/broken.torch: " in artifact()

    # A person puts version 1 to use. Then what it learnt is withdrawn, and something else comes.
    assert slg("versions", tmp_path / "models", "--use", "1")[0] == 0
    (tmp_path / "withdrawn.txt").write_text(f"{first.key}\n")
    arrive(tmp_path, second)
    retrain("refused")
    row = record(tmp_path)
    assert row["before_iou"] > 0 and row["against"] == 1 and "depth" in row["quantities"]
    assert json.loads(artifact(HISTORY))[0]["outcome"] == "refused"
    assert "refused" in slg("versions", tmp_path / "models")[1].partition("last retrainings")[2]
    added = versions.all()[-1]
    assert (added.number, added.parent) == (2, 1)
    assert record(tmp_path)["split"] == added.split != ""
    for table in ("views", "pairs", "lessons"):
        assert read_clips(tmp_path, table) == {second.key, judged.key}

    # What cannot be done is a failure with an artifact, and the next one is as good.
    (chunk,) = (tmp_path / "chunks").glob(f"{judged.key.replace(' ', '_')}.torch")
    chunk.rename(tmp_path / "judged")
    assert "held_out 0.4: found 1 training clips and 0 held-out" in retrain("failed")
    assert record(tmp_path)["reason"].startswith("held_out 0.4: found")
    assert artifact().startswith("# Retraining: failed\n\nheld_out 0.4")
    (tmp_path / "judged").rename(chunk)
    assert "nothing new since version 2; version 1 is in use" in retrain("nothing new")
    (tmp_path / "models" / "history.parquet").write_bytes(b"no table")
    assert "history.parquet: " in retrain("failed")


def test_retrain_records_nothing_after_an_interrupt(tmp_path, monkeypatch):
    values = {"sources": ["procedural:1"], "out": tmp_path, "models": tmp_path / "models"}

    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(corpus, "supervise", interrupt)
    with pytest.raises(KeyboardInterrupt):
        retrain.fn(
            validate_settings(RetrainSettings, {**values, "store": str(tmp_path)}, "retrain")
        )
    assert not (tmp_path / "models" / "history.parquet").exists()


def test_retrain_refuses_unusable_settings(tmp_path, refusal):
    config = tmp_path / "night.toml"
    config.write_text(CONFIG)
    (tmp_path / "chunks").mkdir()
    (tmp_path / "chunks" / "one.torch").touch()
    assert "withdrawn.txt: cannot be read" in refusal("retrain", config)
    config.write_text(CONFIG.replace("replicas", "copies"))
    assert "night.toml: unknown key 'copies'" in refusal("retrain", config)
