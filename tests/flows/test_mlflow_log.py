"""Runs in MLflow, read by its own client."""

import json
import logging
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command import ROOM, score

from flows.read_config import make_settings
from slgaussian.benchmark.mlflow_log import URI, log_results
from slgaussian.benchmark.retrainings import History
from slgaussian.storage.store import ArtifactStore

mlflow = pytest.importorskip("mlflow", reason="needs the extra mlflow")


@pytest.fixture
def tracking(monkeypatch, tmp_path) -> str:
    uri = (tmp_path / "mlflow").as_uri()
    monkeypatch.setenv(URI, uri)
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    mlflow.set_tracking_uri(None)
    logging.getLogger("mlflow").setLevel(logging.ERROR)
    return uri


def runs_in(uri: str) -> list:
    client = mlflow.MlflowClient(uri)
    experiment = client.get_experiment_by_name("slgaussian")
    return client.search_runs([experiment.experiment_id], order_by=["attribute.start_time"])


@pytest.mark.usefixtures("server")
def test_log_results_logs_a_run(tracking, tmp_path):
    out = tmp_path / "out"
    settings = make_settings({"size": "64x96", "out": out, "scenes": [ROOM]}, "test")
    score(settings, ArtifactStore(tmp_path / "store"))
    (run,) = runs_in(tracking)
    assert (run.info.run_name, run.info.status) == ("run out", "FINISHED")
    manifest = json.loads((out / "manifest.json").read_text())
    assert run.data.params["settings.predictor"] == manifest["settings"]["predictor"]
    assert run.data.params["stages.field"] == str(manifest["stages"]["field"])
    rows = pq.read_table(out / "scores.parquet").to_pylist()
    assert rows and run.data.metrics == {
        "/".join(row[key] for key in ("dataset", "protocol", "method", "metric")).replace(
            "@", "_"
        ): (pytest.approx(row["value"]))
        for row in rows
    }
    page = mlflow.artifacts.download_artifacts(
        run_id=run.info.run_id, artifact_path="report.html", tracking_uri=tracking
    )
    assert Path(page).read_bytes() == (out / "report.html").read_bytes()


def test_log_results_logs_a_retraining(tracking, tmp_path):
    history = History(tmp_path)
    history.add({"outcome": "refused", "reason": "a", "seconds": 1.0})
    history.add({"outcome": "promoted", "reason": "b", "version": 2, "seconds": 2.0})
    assert log_results("supervise", tmp_path) == ""
    assert log_results("retrain", tmp_path, tmp_path) == ""
    (run,) = runs_in(tracking)
    assert run.data.metrics == {"version": 2, "seconds": 2.0}
    assert run.data.tags["outcome"] == "promoted"


def test_log_results_describes_an_error_of_mlflow(tracking, tmp_path, monkeypatch):
    (tmp_path / "manifest.json").write_text('{"settings": {}}')
    (tmp_path / "mlflow").write_text("a file where the folder would be")
    message = log_results("run", tmp_path)
    assert message.startswith("not logged to MLflow (") and "\n" not in message
    monkeypatch.delenv(URI)
    assert log_results("run", tmp_path) == ""
