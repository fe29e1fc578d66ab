"""Training checkpoints on disk: complete state for a resume, in formats that cannot run code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import torch

from slgaussian.errors import InputError
from slgaussian.io import write_atomic
from slgaussian.semantic.branch import Branch, branch_of, encode_tensors, read_tensors
from slgaussian.storage.encoding import decode_table, encode_table
from slgaussian.storage.specs import load_spec

CHECKPOINT, METRICS = "checkpoint.safetensors", "metrics.parquet"


@dataclass(frozen=True)
class ResumePoint:
    """State of an interrupted training: number of finished steps, and their rows of metrics."""

    step: int
    rows: list[dict[str, Any]]


def save_checkpoint(
    folder: Path,
    branch: Branch,
    optimiser: torch.optim.Optimizer,
    run: Mapping[str, Any],
    rows: list[dict[str, Any]],
) -> None:
    """Write a checkpoint; a crash at any moment leaves either this one or the previous one.

    Parameters
    ----------
    folder : Path
        Gets ``checkpoint.safetensors`` and ``metrics.parquet``, each replaced atomically. The
        metrics are written first: a resume drops rows of steps after the checkpoint.
    run : mapping
        Settings and inputs of the training, as JSON data; only an equal run may resume.
    rows : list of dict
        One row per step, with the columns of ``data_specs/metrics.toml``.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    tensors = {f"branch.{name}": t.detach() for name, t in branch.state_dict().items()}
    for index, state in optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": t.detach() for name, t in state.items()}
    statement = {"step": len(rows), "run": run}
    try:
        write_atomic(folder / METRICS, encode_table(table_of(rows), load_spec("metrics")))
        write_atomic(folder / CHECKPOINT, encode_tensors(tensors, statement))
    except OSError as error:
        raise InputError(
            f"checkpoint in {folder}: cannot be written ({error.strerror}); make room, or choose "
            "another folder, and run again: it goes on from the last one"
        ) from error


def load_checkpoint(
    folder: Path, branch: Branch, optimiser: torch.optim.Optimizer, run: Mapping[str, Any]
) -> ResumePoint:
    """Restore ``branch`` and ``optimiser`` to the state of :func:`save_checkpoint`.

    Raises
    ------
    InputError
        If a file is damaged or the checkpoint is of another run than ``run``.
    SpecError
        If the metrics are damaged.
    """
    file = folder / CHECKPOINT
    if not file.is_file():
        return ResumePoint(0, [])
    tensors, statement = read_tensors(file)
    stored = statement.get("run")
    if stored != dict(run):
        raise InputError(
            f"checkpoint {file}: is of another training ({_difference(stored, run)}); choose an "
            "empty folder, or go on with what it was begun with"
        )
    step = statement.get("step")
    parts: dict[str, dict[str, torch.Tensor]] = {"branch": {}, "optimiser": {}}
    state: dict[int, dict[str, torch.Tensor]] = {}
    try:
        if not isinstance(step, int) or step < 0:
            raise ValueError(f"found step {step!r:.40}")
        for name, tensor in tensors.items():
            part, _, rest = name.partition(".")
            parts[part][rest] = tensor
        for name, tensor in parts["optimiser"].items():
            index, _, rest = name.partition(".")
            state.setdefault(int(index), {})[rest] = tensor
        _check_state(state, list(branch.parameters()))
    except (KeyError, ValueError) as error:
        raise InputError(
            f"checkpoint {file}: is damaged ({str(error)[:200]}); begin in an empty folder"
        ) from None
    architecture = {"architecture": run["architecture"]}
    loaded = branch_of(parts["branch"], architecture, file)
    branch.load_state_dict(loaded.state_dict())
    groups = optimiser.state_dict()["param_groups"]
    optimiser.load_state_dict({"state": state, "param_groups": groups})
    metrics = folder / METRICS
    try:
        data = metrics.read_bytes()
    except OSError as error:
        raise InputError(f"{metrics}: {error.strerror}; begin in an empty folder") from None
    table = decode_table(data, load_spec("metrics"), str(metrics), "begin in an empty folder")
    return ResumePoint(step, table.to_pylist()[:step])


def _check_state(
    state: Mapping[int, Mapping[str, torch.Tensor]], parameters: Sequence[torch.Tensor]
) -> None:
    """Raise ValueError unless ``state`` is that of an AdamW over ``parameters``."""
    for index, moments in state.items():
        shapes = {name: tuple(tensor.shape) for name, tensor in moments.items()}
        shape = tuple(parameters[index].shape) if 0 <= index < len(parameters) else None
        if shapes != {"step": (), "exp_avg": shape, "exp_avg_sq": shape}:
            raise ValueError(f"optimiser.{index} is of no parameter")


def table_of(rows: list[dict[str, Any]]) -> pa.Table:
    """Convert rows to a table of spec ``metrics``."""
    return pa.Table.from_pylist(rows, schema=load_spec("metrics").schema)


def _difference(stored: Any, run: Mapping[str, Any]) -> str:
    if not isinstance(stored, Mapping):
        return "it does not say of which"
    names = [name for name in run if stored.get(name) != run[name]]
    return ", ".join(f"{name} {stored.get(name)} instead of {run[name]}" for name in names)
