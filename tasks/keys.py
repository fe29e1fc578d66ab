"""Cache keys: what a result depends on, in one canonical form, or an error."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactRef


def cache_key(
    stage: str, version: int, settings: Mapping[str, Any], inputs: Mapping[str, ArtifactRef]
) -> str:
    """The key ``<stage>/v<version>/<sha256>`` of one piece of work.

    Two keys are equal if and only if stage, version, settings and the digests of the inputs are:
    the order of keys, the process and the place of the store play no part.

    Raises
    ------
    InputError
        If a setting has no canonical form (see :func:`canonical`).
    """
    content = {"settings": canonical(settings, "settings"), "inputs": canonical(inputs, "inputs")}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"{stage}/v{version}/{hashlib.sha256(text.encode()).hexdigest()}"


def canonical(value: Any, name: str = "value") -> Any:
    """``value`` as plain JSON data; refs become their spec and digest, tuples become lists.

    Raises
    ------
    InputError
        For anything whose identity is not its plain content: arrays (pass a ref), paths (the file
        may change; hash it when it is ingested), sets, generators, NaN and objects. A guess here
        would be a stale result later.
    """
    if value is None or isinstance(value, (bool, str)) or type(value) is int:
        return value
    if type(value) is float and math.isfinite(value):
        return value
    if isinstance(value, ArtifactRef):
        return {"spec": value.spec, "digest": value.digest}
    if isinstance(value, (list, tuple)):
        return [canonical(item, f"{name}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: canonical(item, f"{name}.{key}") for key, item in value.items()}
    raise InputError(
        f"{name}: {type(value).__name__} {value!r:.60} cannot be part of a cache key; expected "
        "plain numbers, text, lists, tables with text keys, or artifact refs"
    )
