"""The JSON schema of a configuration file of `slgaussian run`."""

import json


def schema() -> str:
    """Return it as text."""
    from flows.settings import Settings

    return json.dumps(Settings.model_json_schema(), indent=1)
