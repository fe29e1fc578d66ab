"""Training checkpoints on disk: complete state for a resume, read without running code."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import torch

from slgaussian.errors import InputError
from slgaussian.formats import tensorfile
from slgaussian.io import write_file
from slgaussian.semantic.branch import Branch
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec

CHECKPOINT = "checkpoint.pt"


def save_checkpoint(
    folder: Path,
    branch: Branch,
    optimiser: torch.optim.Optimizer,
    run: Mapping[str, Any],
    rows: list[dict[str, Any]],
) -> None:
    """Replace ``checkpoint.pt`` in ``folder`` atomically.

    ``run`` are settings and inputs of the training, as plain data; only an equal run may resume.
    ``rows`` are the metrics, one row per step, with the columns of ``data_specs/metrics.toml``.

    Raises:
        InputError: If it cannot be written.
    """
    metrics = encode_table(tabulate_metrics(rows), load_spec("metrics"))
    state = {
        "run": dict(run),
        "branch": branch.state_dict(),
        "optimiser": optimiser.state_dict(),
        "metrics": torch.frombuffer(bytearray(metrics), dtype=torch.uint8),
    }
    content = io.BytesIO()
    torch.save(state, content)
    write_file(folder / CHECKPOINT, content.getbuffer())


def load_checkpoint(
    folder: Path, branch: Branch, optimiser: torch.optim.Optimizer, run: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Restore ``branch`` and ``optimiser``; return the metrics of the finished steps.

    Without a checkpoint there are none.

    Raises:
        InputError: If the file is damaged or of another run than ``run``.
        SpecError: If its metrics are damaged.
    """
    file, otherwise = folder / CHECKPOINT, "begin in an empty folder"
    if not file.is_file():
        return []
    try:
        state = tensorfile.load(file)
        stored, metrics = dict(state["run"]), state["metrics"].numpy().tobytes()
        if stored == run:
            branch.load_state_dict(state["branch"])
            optimiser.load_state_dict(state["optimiser"])
            for parameter, moments in optimiser.state.items():
                if any(moment.shape not in (parameter.shape, ()) for moment in moments.values()):
                    raise ValueError("moments of another shape than their parameter")
    except Exception as error:  # a damaged file raises almost anything
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"checkpoint {file}: is damaged ({reason}); {otherwise}") from None
    if stored != run:
        names = [name for name in run if stored.get(name) != run[name]]
        actual = ", ".join(f"{name} {stored.get(name)} instead of {run[name]}" for name in names)
        raise InputError(
            f"checkpoint {file}: is of another training ({actual}); choose an empty folder, or go "
            "on with what it was begun with"
        )
    table = decode_table(metrics, load_spec("metrics"), str(file), otherwise)
    return list(table.to_pylist())


def tabulate_metrics(rows: list[dict[str, Any]]) -> pa.Table:
    """Convert rows to a table of spec ``metrics``."""
    return pa.Table.from_pylist(rows, schema=load_spec("metrics").schema)
