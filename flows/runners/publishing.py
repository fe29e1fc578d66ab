"""Prefect artifacts of a run, where its server is the user's: ours ends with the command."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from typing import Any

from prefect.artifacts import create_markdown_artifact, create_table_artifact

from flows.runners.log_file import log
from flows.runners.task_runners import NO_EVENTS

MOST_ROWS = 500
"""Rows of a table artifact at most: Prefect keeps it in a database and shows it on one page."""


def publish_markdown(key: str, markdown: str, description: str = "") -> None:
    """Create a Markdown artifact of a key, lower-case letters, digits and dashes."""
    _publish(lambda: create_markdown_artifact(markdown, key, description or None))


def publish_table(key: str, rows: Sequence[dict[str, Any]], description: str = "") -> None:
    """Create a table artifact of a key, of the first :data:`MOST_ROWS` rows."""
    table = list(rows[:MOST_ROWS])
    _publish(lambda: create_table_artifact(table, key, description or None))


def _publish(create: Any) -> None:
    if NO_EVENTS in os.environ:
        return
    try:
        create()
    except Exception as error:  # a server that is gone costs the artifact, not the run
        log(logging.WARNING, "artifact_failed", f"an artifact was not created: {error}")
