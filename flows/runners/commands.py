"""Flows as commands start them: with Prefect ready, and its errors in a sentence."""

from __future__ import annotations

import logging
import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from httpx import HTTPError

from flows.runners.environment import orchestration
from flows.runners.log_file import log
from slgaussian.errors import SLGaussianError
from slgaussian.storage.remote import redacted
from slgaussian.storage.store import ArtifactStore

if TYPE_CHECKING:  # Prefect is imported once its environment is set
    from prefect import Flow

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
    store = ArtifactStore(config.store)
    with orchestration(store) as wait_for_server:
        # Its imports take as long as the server needs to come up.
        place, name = FLOWS[command].split(":")
        module = import_module(place)
        if hasattr(module, "check"):
            module.check(config, store)
        wait_for_server()
        return call_flow(getattr(module, name), config, verbose)


def call_flow(flow: Flow[..., Any], *arguments: Any) -> Any:
    """Call a flow that ends in :func:`flows.runners.session.completed`; return its result.

    A server that fails during the work, as when it is killed or its disk is full, costs no more
    than that it does not learn the end.

    Raises
    ------
    SLGaussianError
        As the flow, and if the server fails before the work is done.
    """
    from flows.runners.session import RESULTS

    RESULTS.clear()
    try:
        return flow(*arguments)
    except HTTPError as error:
        url, home = redacted(os.environ["PREFECT_API_URL"]), os.environ["PREFECT_HOME"]
        failed = f"the Prefect server at {url} failed ({error})"
        if RESULTS:
            message = f"{failed} when all was done; it may show this run as running for ever"
            log(logging.WARNING, "server_failed", message)
            return RESULTS[0]
        raise SLGaussianError(
            f"{failed}; start it, or unset PREFECT_API_URL, as none of yours is needed; one of our "
            f"own may need room on the disk of {home}; what was made is in the store, and the same "
            "command goes on"
        ) from error
