"""Automations of a Prefect server: alerts to a webhook, and crashes told by missing heartbeats.

``python -m flows.automations URL`` creates those of ``automations.yaml`` on the server of
``PREFECT_API_URL``, or updates them.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from httpx import HTTPError
from prefect.blocks.webhook import Webhook
from prefect.client.orchestration import get_client
from prefect.events.schemas.automations import AutomationCore
from prefect.settings import PREFECT_API_URL

from slgaussian.storage.remote import redact

AUTOMATIONS = Path(__file__).with_name("automations.yaml")


def read_automations() -> list[dict[str, Any]]:
    """Read the automations of the package, in Prefect's YAML but for the id of the webhook."""
    return yaml.safe_load(AUTOMATIONS.read_text("utf-8"))["automations"]


def apply_automations(automations: Sequence[Mapping[str, Any]], url: str) -> list[str]:
    """Create or update automations by name, with a webhook block for ``url``.

    Args:
        automations: As of :func:`read_automations`; ``block`` of an action names the webhook block.

    Returns the names of the automations.
    """
    headers = {"Content-Type": "application/json"}
    with get_client(sync_client=True) as client:
        for automation in automations:
            actions = []
            for action in automation["actions"]:
                rest = {key: value for key, value in action.items() if key != "block"}
                if "block" in action:
                    block = Webhook(url=url, headers=headers)
                    rest["block_document_id"] = block.save(action["block"], overwrite=True)
                actions.append(rest)
            core = AutomationCore.model_validate({**automation, "actions": actions})
            existing = client.read_automations_by_name(core.name)
            if existing:
                client.update_automation(existing[0].id, core)
            else:
                client.create_automation(core)
    return [automation["name"] for automation in automations]


if __name__ == "__main__":
    if len(sys.argv) != 2 or "://" not in sys.argv[1]:
        sys.exit("usage: python -m flows.automations URL-OF-A-WEBHOOK")
    server = PREFECT_API_URL.value()
    if server is None:  # Prefect would start a server that ends with this program
        sys.exit("error: PREFECT_API_URL is not set; set it to the address of your Prefect server")
    try:
        print("\n".join(apply_automations(read_automations(), sys.argv[1])))
    except HTTPError as error:
        sys.exit(
            f"error: the Prefect server at {redact(server)} failed ({error}); start it with "
            "`prefect server start`, or correct PREFECT_API_URL"
        )
