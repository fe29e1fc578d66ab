"""Each problem of an installation is one line, and does not hide the others."""

from importlib.metadata import version

import numpy as np
import pytest
import torch

from tests.masks.small_models import save_sam

NOBODY = "http://127.0.0.1:9/api"


@pytest.fixture
def examine(slg):
    """Run ``slgaussian doctor``; return exit status and lines by mark (ok, BAD)."""

    def examine(*words) -> tuple[int, dict[str, list[str]]]:
        status, out, _ = slg("doctor", *words)
        report = {"ok": [], "BAD": []}
        for line in out.splitlines():
            mark, message = line.split(maxsplit=1)
            report[mark].append(" ".join(message.split()))
        return status, report

    return examine


def test_doctor_passes_healthy_installation(server, tmp_path, examine):
    status, report = examine("--store", tmp_path / "store")
    assert report["BAD"] == [] and status == 0
    names = [line.split()[0] for line in report["ok"]]
    assert names == ["slgaussian", "packages", "threads", "store", "server", "numerics"]
    assert f"torch {torch.__version__}, numpy {np.__version__}" in report["ok"][1]
    assert f"server Prefect's server {version('prefect')} answers at {server.url}" in report["ok"]


@pytest.mark.whole
def test_doctor_leaves_no_files(tmp_path, monkeypatch, examine):
    """The command starts a server, whose database is removed too."""
    monkeypatch.delenv("PREFECT_API_URL")
    monkeypatch.delenv("PREFECT_HOME", raising=False)
    monkeypatch.chdir(tmp_path)
    status, report = examine()
    assert report["BAD"] == [] and status == 0
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine").mkdir()
    examine("--store", "mine/deep/store")
    assert list(tmp_path.rglob("*")) == [tmp_path / "mine"]


def test_unusable_store_is_one_bad_line(server, tmp_path, examine):
    (tmp_path / "file").write_text("in the way")
    for store, message in [
        ("foo://x", "store foo://x: Protocol not known: foo"),
        (tmp_path / "file" / "store", "cannot write there (Not a directory); choose a writable"),
    ]:
        status, report = examine("--store", store)
        assert status == 1 and len(report["BAD"]) == 1
        assert message in report["BAD"][0]
        assert len(report["ok"]) == 5


def test_server_without_answer_is_one_bad_line(tmp_path, monkeypatch, examine):
    monkeypatch.setenv("PREFECT_API_URL", NOBODY)
    status, report = examine("--store", tmp_path)
    (bad,) = report["BAD"]
    assert status == 1 and f"PREFECT_API_URL {NOBODY}: no Prefect server answers there" in bad
    assert "prefect server start" in bad


def test_doctor_checks_given_runner(server, tmp_path, examine):
    status, report = examine("--store", tmp_path, "--runner", "processes")
    assert status == 0 and report["ok"][-1] == "runner processes can be started"
    status, report = examine("--store", tmp_path, "--runner", "ray://[::1]:9")
    assert status == 1 and "runner" in report["BAD"][0]


def test_doctor_loads_models_and_reports_damaged_ones(server, tmp_path, examine):
    pytest.importorskip("transformers")
    save_sam(tmp_path / "sam")
    words = ["--store", tmp_path / "store", "--proposer", "sam"]
    words += ["--set", f"sam.model={tmp_path}/sam"]
    status, report = examine(*words)
    assert report["BAD"] == [] and status == 0
    assert report["ok"][-1].startswith(f"sam model {tmp_path / 'sam'}: can be loaded")
    (tmp_path / "small.ckpt").write_bytes(b"no checkpoint")
    (tmp_path / "sam" / "model.safetensors").write_bytes(b"\xff" * 20)
    words += ["--predictor", "mvsplat", "--set", f"mvsplat.checkpoint={tmp_path}/small.ckpt"]
    status, report = examine(*words)
    assert status == 1
    for line, expected in zip(report["BAD"], ["small.ckpt: is damaged", "sam"], strict=True):
        assert expected in line
