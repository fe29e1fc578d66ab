"""What the commands that run flows do, whether people or a schedule start them."""

from __future__ import annotations

import logging
import sys
from importlib import import_module
from typing import Any

from flows.runners.environment import orchestration
from flows.runners.journal import journal, log
from slgaussian import __version__
from slgaussian.errors import InputError
from slgaussian.storage.provenance import Made, making
from slgaussian.storage.store import ArtifactStore, DamagedError

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

    Where an artifact turns out to be damaged when it is handed out or asked for by another job, it
    is removed and the work is done again, which makes it anew and finds the rest in the store.

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
        As that function, and if a damaged artifact is none that it makes.
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
        damaged: dict[str, str] = {}
        while True:
            try:
                return work(settings, store, verbose)
            except DamagedError as error:
                if error.uri in damaged:
                    raise InputError(
                        f"{damaged[error.uri]}; this command does not make it: first run the one "
                        "that does, such as `slgaussian supervise`"
                    ) from error
                damaged[error.uri] = str(error)
                store.remove([error.uri])
                message = (
                    f"{store.root}/{error.uri} is damaged; it is removed, and the work begins anew"
                )
                log(logging.WARNING, "damaged", message)
                print(message, file=sys.stderr, flush=True)
