"""Cache keys: what a result depends on, in one canonical form, or an error."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from slgaussian.components.component import Component
from slgaussian.errors import InputError
from slgaussian.io import KnownFile
from slgaussian.storage.store import ArtifactRef


def cache_key(stage: str, version: int, arguments: Mapping[str, Any]) -> str:
    """The key ``<stage>/v<version>/<sha256>`` of one piece of work.

    Two keys are equal if and only if stage, version and the content of the arguments are: the order
    of keys, the process and the places of files and of the store play no part.

    Raises
    ------
    InputError
        If an argument has no canonical form (see :func:`canonical`).
    """
    content = {name: canonical(value, name) for name, value in arguments.items()}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"{stage}/v{version}/{hashlib.sha256(text.encode()).hexdigest()}"


def canonical(value: Any, name: str = "value") -> Any:
    """``value`` as plain JSON data; refs become their spec and digest, tuples become lists.

    A dataclass is its fields. What comes from outside, as files and the parts of the method, says
    itself what it is known by: it has a method ``identity`` that returns such data.

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
    if isinstance(value, KnownFile):
        return value.digest
    if isinstance(value, Component):
        return {value.name: canonical(value.identity(), name)}
    if hasattr(value, "identity"):
        return canonical(value.identity(), name)
    if is_dataclass(value) and not isinstance(value, type):
        own = {field.name: getattr(value, field.name) for field in fields(value)}
        return canonical(own, name)
    if isinstance(value, (list, tuple)):
        return [canonical(item, f"{name}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        # In one order, whether it was just made or read from a record: files say it as it stands.
        return {key: canonical(value[key], f"{name}.{key}") for key in sorted(value)}
    raise InputError(
        f"{name}: {type(value).__name__} {value!r:.60} cannot be part of a cache key; expected "
        "plain numbers, text, lists, tables with text keys, or artifact refs"
    )
