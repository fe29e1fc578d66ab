"""Logging of the results of a run or a retraining to MLflow (extra ``mlflow``)."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from slgaussian.benchmark.reports.model import flatten
from slgaussian.benchmark.retrainings import read_history
from slgaussian.extras import install_line
from slgaussian.formats.documents import read_json
from slgaussian.storage.specs import load_spec
from slgaussian.storage.tables import read_table

URI = "MLFLOW_TRACKING_URI"
"""MLflow's variable (https://mlflow.org/docs/latest/ml/tracking/): results are logged if it is set,
to the experiment ``slgaussian`` or the one in ``MLFLOW_EXPERIMENT_NAME``."""

PARAMETERS = ("slgaussian", "seed", "settings", "weights", "index", "stages")
"""Parts of a manifest that are logged as parameters."""

MANIFEST, SCORES = "manifest.json", "scores.parquet"
RUN_FILES = (MANIFEST, SCORES, "report.html", "report.md", "run.toml")

BATCH = 100
"""Largest number of parameters that MLflow accepts at once."""


class Results(NamedTuple):
    """What is logged: parameters, metrics and outcome, and files as artifacts."""

    parameters: dict[str, str]
    metrics: dict[str, float]
    outcome: str
    files: Sequence[Path]


def log_results(command: str, out: Path, models: Path | None = None) -> str:
    """Log the results of a command in an output folder, if MLflow is asked for.

    The parameters are settings, weights and versions; the metrics are the scores, named
    DATASET/PROTOCOL/METHOD/METRIC, or the numbers of the last retraining in a folder ``models``.

    Returns:
        str: Why not all was logged; empty if it was, or there is nothing to log.
    """
    if not os.environ.get(URI) or command not in ("run", "retrain"):
        return ""
    try:
        results = _read_run(out) if models is None else _read_retraining(out, models)
        if results is None:
            return ""
        import mlflow

        if not os.environ.get("MLFLOW_EXPERIMENT_NAME"):
            mlflow.set_experiment("slgaussian")
        with mlflow.start_run(run_name=f"{command} {out.name}", nested=True):
            mlflow.set_tag("outcome", results.outcome)
            parameters = [*results.parameters.items()]
            for start in range(0, len(parameters), BATCH):
                mlflow.log_params(dict(parameters[start : start + BATCH]))
            mlflow.log_metrics(results.metrics)
            for file in results.files:
                if file.is_file():
                    mlflow.log_artifact(str(file))
    except ImportError as error:
        return f"not logged to MLflow, which is missing ({error}): {install_line('mlflow')}"
    except Exception as error:  # MLflow's own, and those of any data base
        reason = " ".join(str(error).split())
        return f"not logged to MLflow ({type(error).__name__}: {reason}); the results are in {out}"
    return ""


def _read_run(out: Path) -> Results | None:
    if not (out / MANIFEST).is_file():
        return None
    manifest = read_json(out / MANIFEST, "manifest")
    facts = flatten({name: manifest[name] for name in PARAMETERS if name in manifest})
    rows = read_table(out / SCORES).to_pylist() if (out / SCORES).is_file() else []
    columns = ("dataset", "protocol", "method", "metric")
    metrics = {_valid("/".join(row[name] for name in columns)): row["value"] for row in rows}
    parameters = {_valid(name): value for name, value in facts.items()}
    return Results(parameters, metrics, "completed", [out / name for name in RUN_FILES])


def _read_retraining(out: Path, models: Path) -> Results | None:
    rows = read_history(models).to_pylist()[-1:]
    if not rows:
        return None
    metrics = {name: float(v) for name, v in rows[0].items() if isinstance(v, int | float)}
    files = [out / "report.html", models / load_spec("history").file]
    return Results({}, metrics, rows[0]["outcome"], files)


def _valid(name: str) -> str:
    """Replace the characters that MLflow refuses in names."""
    return re.sub(r"[^\w\-. /]", "_", name)
