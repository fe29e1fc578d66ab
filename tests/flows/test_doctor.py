"""What is wrong with an installation is one line each, and never hides the other lines."""

from importlib.metadata import version

import numpy as np
import pytest
import torch

from tests.masks.small_models import save_sam

NOBODY = "http://127.0.0.1:9/api"


@pytest.fixture
def examined(slg):
    """Exit status, and the lines by mark: ok, BAD."""

    def examined(*words) -> tuple[int, dict[str, list[str]]]:
        status, out, _ = slg("doctor", *words)
        told = {"ok": [], "BAD": []}
        for line in out.splitlines():
            mark, said = line.split(maxsplit=1)
            told[mark].append(" ".join(said.split()))
        return status, told

    return examined


def test_a_healthy_installation(server, tmp_path, examined):
    status, told = examined("--store", tmp_path / "store")
    assert told["BAD"] == [] and status == 0
    names = [line.split()[0] for line in told["ok"]]
    assert names == ["slgaussian", "packages", "threads", "store", "server", "numerics"]
    assert f"torch {torch.__version__}, numpy {np.__version__}" in told["ok"][1]
    assert f"server Prefect's server {version('prefect')} answers at {server.url}" in told["ok"]


@pytest.mark.whole
def test_it_leaves_nothing_that_it_made(tmp_path, monkeypatch, examined):
    """With a server of its own, whose database is not left either."""
    monkeypatch.delenv("PREFECT_API_URL")
    monkeypatch.delenv("PREFECT_HOME", raising=False)
    monkeypatch.chdir(tmp_path)
    status, told = examined()
    assert told["BAD"] == [] and status == 0
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine").mkdir()
    examined("--store", "mine/deep/store")
    assert list(tmp_path.rglob("*")) == [tmp_path / "mine"]


def test_a_store_that_cannot_be_used_is_one_line(server, tmp_path, examined):
    (tmp_path / "file").write_text("in the way")
    for store, said in [
        ("foo://x", "store foo://x: Protocol not known: foo"),
        (tmp_path / "file" / "store", "cannot write there (Not a directory); choose a writable"),
    ]:
        status, told = examined("--store", store)
        assert status == 1 and len(told["BAD"]) == 1
        assert said in told["BAD"][0]
        assert len(told["ok"]) == 5


def test_a_server_that_does_not_answer(tmp_path, monkeypatch, examined):
    monkeypatch.setenv("PREFECT_API_URL", NOBODY)
    status, told = examined("--store", tmp_path)
    (bad,) = told["BAD"]
    assert status == 1 and f"PREFECT_API_URL {NOBODY}: no Prefect server answers there" in bad
    assert "prefect server start" in bad


def test_the_runner_is_looked_at(server, tmp_path, examined):
    status, told = examined("--store", tmp_path, "--runner", "processes")
    assert status == 0 and told["ok"][-1] == "runner processes can be started"
    status, told = examined("--store", tmp_path, "--runner", "ray://[::1]:9")
    assert status == 1 and "runner" in told["BAD"][0]


def test_files_of_models_are_tried(server, tmp_path, examined):
    pytest.importorskip("transformers")
    save_sam(tmp_path / "sam")
    words = ["--store", tmp_path / "store", "--proposer", "sam"]
    words += ["--set", f"sam.model={tmp_path}/sam"]
    status, told = examined(*words)
    assert told["BAD"] == [] and status == 0
    assert told["ok"][-1].startswith(f"sam model {tmp_path / 'sam'}: can be loaded")
    (tmp_path / "small.ckpt").write_bytes(b"no checkpoint")
    (tmp_path / "sam" / "model.safetensors").write_bytes(b"\xff" * 20)
    words += ["--predictor", "mvsplat", "--set", f"mvsplat.checkpoint={tmp_path}/small.ckpt"]
    status, told = examined(*words)
    assert status == 1
    for found, said in zip(told["BAD"], ["small.ckpt: is damaged", "sam"], strict=True):
        assert said in found
