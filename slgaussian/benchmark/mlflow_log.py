"""Logging of the results of a run or a retraining to MLflow (extra ``mlflow``)."""

from __future__ import annotations

import os
import re
from pathlib import Path

from slgaussian.benchmark.documents import read_json
from slgaussian.benchmark.reports.model import flatten
from slgaussian.extras import install_line
from slgaussian.storage.encoding import decode_table
from slgaussian.storage.specs import load_spec

URI = "MLFLOW_TRACKING_URI"
"""MLflow's variable (https://mlflow.org/docs/latest/ml/tracking/): results are logged if it is set,
to the experiment ``slgaussian`` or the one in ``MLFLOW_EXPERIMENT_NAME``."""

DOCUMENTS = {"run": "manifest.json", "retrain": "retraining.json"}
"""Descriptions of results by the command that writes them."""

PARAMETERS = ("slgaussian", "seed", "settings", "weights", "index", "stages")
"""Parts of a manifest that are logged as parameters."""

SCORES = "scores.parquet"
FILES = (*DOCUMENTS.values(), SCORES, "report.html", "report.md", "run.toml")

BATCH = 100
"""Largest number of parameters that MLflow accepts at once."""


def log_results(command: str, out: Path) -> str:
    """Log the results of a command in an output folder, if MLflow is asked for.

    The parameters are settings, weights and versions; the metrics are the scores, named
    DATASET/PROTOCOL/METHOD/METRIC, or the numbers of a retraining; :data:`FILES` are artifacts.

    Returns:
        str: Why not all was logged; empty if it was, or there is nothing to log.
    """
    if not os.environ.get(URI) or not (file := out / DOCUMENTS.get(command, "-")).is_file():
        return ""
    try:
        import mlflow

        document, metrics = read_json(file, "document"), dict[str, float]()
        facts = flatten({name: document[name] for name in PARAMETERS if name in document})
        parameters = [(_valid(name), value) for name, value in facts.items()]
        if command == "retrain":
            for name, text in flatten(document).items():
                if re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?", text):
                    metrics[_valid(name)] = float(text)
        elif (out / SCORES).is_file():
            scores = decode_table((out / SCORES).read_bytes(), load_spec("scores"), SCORES)
            for row in scores.to_pylist():
                names = (row[key] for key in ("dataset", "protocol", "method", "metric"))
                metrics[_valid("/".join(names))] = row["value"]
        if not os.environ.get("MLFLOW_EXPERIMENT_NAME"):
            mlflow.set_experiment("slgaussian")
        with mlflow.start_run(run_name=f"{command} {out.name}", nested=True):
            mlflow.set_tag("outcome", document.get("outcome", "completed"))
            for start in range(0, len(parameters), BATCH):
                mlflow.log_params(dict(parameters[start : start + BATCH]))
            mlflow.log_metrics(metrics)
            for name in FILES:
                if (out / name).is_file():
                    mlflow.log_artifact(str(out / name))
    except ImportError as error:
        return f"not logged to MLflow, which is missing ({error}): {install_line('mlflow')}"
    except Exception as error:  # MLflow's own, and those of any data base
        reason = " ".join(str(error).split())
        return f"not logged to MLflow ({type(error).__name__}: {reason}); the results are in {out}"
    return ""


def _valid(name: str) -> str:
    """Replace the characters that MLflow refuses in names."""
    return re.sub(r"[^\w\-. /]", "_", name)
