"""What the commands that run flows do, whether people or a schedule start them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from flows.runners.environment import orchestration
from flows.runners.journal import journal
from slgaussian import __version__
from slgaussian.storage.provenance import Made, making
from slgaussian.storage.store import ArtifactStore

WORK = {
    "demo": "pipeline.run",
    "benchmark": "pipeline.run",
    "run": "pipeline.run",
    "ingest": "corpus.ingest",
    "supervise": "corpus.supervise",
    "dataset": "dataset.dataset",
    "train": "training.train",
    "retrain": "retraining.retrain",
    "nightly": "nightly.night",
}
"""The function of this package that does the work of a command; it is given the settings, the store
and whether to be verbose."""


def perform(command: str, settings: Any, verbose: bool = False) -> Any:
    """Do the work of a command, with its store, Prefect ready, and a log in its output folder.

    Parameters
    ----------
    command : str
        One of :data:`WORK`.
    settings
        The checked settings of that command, with ``store`` and ``out`` at least.
    verbose : bool

    Raises
    ------
    SLGaussianError
        As that function.
    """
    store = ArtifactStore(settings.store)
    about = {
        "command": command,
        "version": __version__,
        "store": store.root,
        **settings.model_dump(include={"runner", "workers"}),
    }
    module, name = WORK[command].split(".")
    with (
        journal(settings.out, about, verbose),
        orchestration(store) as ready,
        making(Made(command)),
    ):
        # Its imports take as long as the server needs to come up.
        work = getattr(import_module(f"flows.{module}"), name)
        ready()
        return work(settings, store, verbose)
