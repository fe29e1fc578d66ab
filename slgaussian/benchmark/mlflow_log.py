"""Logging of the results of a run or a retraining to MLflow (extra ``mlflow``)."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slgaussian.benchmark.documents import read_json
from slgaussian.benchmark.reports.model import flatten
from slgaussian.extras import install_line
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.specs import load_spec

URI = "MLFLOW_TRACKING_URI"
"""MLflow's environment variable of its server, data base or folder: results are logged if it is set
(https://mlflow.org/docs/latest/ml/tracking/)."""

EXPERIMENT = "slgaussian"
"""Experiment, unless MLflow's ``MLFLOW_EXPERIMENT_NAME`` names another."""

DOCUMENTS = {"run": "manifest.json", "retrain": "retraining.json"}
"""Description of the results of the commands that are logged."""

SCORES = "scores.parquet"
ARTIFACTS = (SCORES, "report.html", "report.md", "run.toml")
"""Further files of the output folder that are logged, if they are there."""

PARAMETERS = ("slgaussian", "seed", "settings", "weights", "index", "stages")
"""Parts of a manifest that are logged as parameters."""

NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")

BATCH = 100
"""Largest number of parameters that MLflow accepts at once."""


def log_results(command: str, out: Path) -> str:
    """Log parameters, scores and reports in an output folder, if MLflow is asked for.

    Parameters are the settings, weights and versions of the manifest; metrics are the scores,
    DATASET/PROTOCOL/METHOD/METRIC, or the numbers of a retraining.

    Returns:
        str: Why nothing was logged, or not all; empty if all was, or :data:`URI` is not set.
    """
    if not os.environ.get(URI) or not (file := out / DOCUMENTS.get(command, "-")).is_file():
        return ""
    try:
        import mlflow

        document = read_json(file, "document")
        parameters = flatten({n: document[n] for n in PARAMETERS if n in document})
        scores: dict[str, Any] = {}
        if command == "retrain":
            scores = {n: v for n, v in flatten(document).items() if NUMBER.fullmatch(v)}
        elif (out / SCORES).is_file():
            table = decode_table((out / SCORES).read_bytes(), load_spec("scores"), SCORES)
            for row in table.to_pylist():
                place = (row[key] for key in ("dataset", "protocol", "method", "metric"))
                scores["/".join(place)] = row["value"]
        if not os.environ.get("MLFLOW_EXPERIMENT_NAME"):
            mlflow.set_experiment(EXPERIMENT)
        with mlflow.start_run(run_name=f"{command} {out.name}", nested=True):
            mlflow.set_tags({"command": command, "outcome": document.get("outcome", "completed")})
            items = list(_with_valid_names(parameters).items())
            for start in range(0, len(items), BATCH):
                mlflow.log_params(dict(items[start : start + BATCH]))
            mlflow.log_metrics({n: float(v) for n, v in _with_valid_names(scores).items()})
            for name in (file.name, *ARTIFACTS):
                if (out / name).is_file():
                    mlflow.log_artifact(str(out / name))
    except ImportError as error:
        return f"not logged to MLflow, which is missing ({error}): {install_line('mlflow')}"
    except Exception as error:  # MLflow's own, and those of any data base
        reason = " ".join(str(error).split())
        return f"not logged to MLflow ({type(error).__name__}: {reason}); the results are in {out}"
    return ""


def _with_valid_names(values: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the characters in names that MLflow refuses."""
    return {re.sub(r"[^\w\-. /]", "_", name): value for name, value in values.items()}
