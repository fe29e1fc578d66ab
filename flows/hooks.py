"""Tell a command or an HTTP address what happened."""

from __future__ import annotations

import http.client
import json
import os
import shlex
import subprocess
import tempfile
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

PATIENCE = 60.0
"""Seconds that it may take."""


def tell(hook: str, facts: Mapping[str, Any], folder: Path) -> str:
    """Tell ``hook``, and say in a sentence what went wrong; empty if nothing did.

    Parameters
    ----------
    hook : str
        An ``http://`` or ``https://`` address, which gets a POST; or a command with its arguments,
        without a shell, which gets ``SLGAUSSIAN_EVENT`` and ``SLGAUSSIAN_SAID`` in its environment,
        and runs in ``folder``.
    facts : mapping
        What they are told, as JSON in the body or on standard input; ``event`` and ``said`` at
        least.
    """
    body = json.dumps(facts).encode()
    if hook.startswith(("http://", "https://")):
        # Its path may be a secret, as that of most chat services is.
        name = f"hook {urlsplit(hook).hostname}"
        kind = {"Content-Type": "application/json", "User-Agent": "slgaussian"}
        try:
            asked = urllib.request.Request(hook, body, kind)
            urllib.request.urlopen(asked, timeout=PATIENCE).close()
        except (OSError, ValueError, http.client.HTTPException) as error:
            return f"{name}: {error}"
        return ""
    said = {"SLGAUSSIAN_EVENT": str(facts["event"]), "SLGAUSSIAN_SAID": str(facts["said"])}
    try:
        words = shlex.split(hook)
        name = f"hook {words[0]}"
    except (ValueError, IndexError) as error:
        return f"hook {hook!r}: is no command ({error})"
    # Files and no pipes: whatever it leaves running would hold those open.
    with tempfile.TemporaryFile() as given, tempfile.TemporaryFile() as heard:
        given.write(body)
        given.seek(0)
        try:
            done = subprocess.run(
                words,
                stdin=given,
                stdout=heard,
                stderr=heard,
                env={**os.environ, **said},
                cwd=folder,
                timeout=PATIENCE,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"{name}: not done within {PATIENCE:.0f} s"
        except OSError as error:
            return f"{name}: cannot be run ({error.strerror})"
        heard.seek(0)
        last = (heard.read().decode(errors="replace").strip().splitlines() or ["no word"])[-1]
    return f"{name}: ended with status {done.returncode} ({last[:200]})" if done.returncode else ""
