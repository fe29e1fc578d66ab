"""Flows as commands start them: with Prefect ready, and its errors in a sentence."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

from httpx import HTTPError

from flows.runners.environment import orchestration
from slgaussian.errors import SLGaussianError
from slgaussian.storage.remote import redacted
from slgaussian.storage.store import ArtifactStore

FLOWS = {
    "demo": "flows.benchmark:score_scenes",
    "benchmark": "flows.benchmark:score_scenes",
    "run": "flows.benchmark:score_scenes",
    "ingest": "flows.corpus:ingest_corpus",
    "supervise": "flows.corpus:supervise_corpus",
    "dataset": "flows.dataset:make_training_set",
    "train": "flows.training:train_branch",
    "retrain": "flows.retraining:retrain",
}
"""The Prefect flow of each command, called with its configuration and whether to be verbose."""


def perform(command: str, config: Any, verbose: bool = False) -> Any:
    """Run the flow of a command; returns what it returns.

    Raises
    ------
    SLGaussianError
        As the flow, and if the Prefect server fails.
    """
    with orchestration(ArtifactStore(config.store)) as wait_for_server:
        # Its imports take as long as the server needs to come up.
        module, name = FLOWS[command].split(":")
        flow = getattr(import_module(module), name)
        wait_for_server()
        try:
            return flow(config, verbose)
        except HTTPError as error:  # as when it was killed, or its disk is full
            url, home = redacted(os.environ["PREFECT_API_URL"]), os.environ["PREFECT_HOME"]
            raise SLGaussianError(
                f"the Prefect server at {url} failed ({error}); start it, or unset PREFECT_API_URL,"
                f" as none of yours is needed; one of our own may need room on the disk of {home}; "
                "what was made is in the store, and the same command goes on"
            ) from error
