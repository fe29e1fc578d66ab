"""Other methods in the same run: each answers the scenes that the field has answered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from flows.settings import SceneSettings, Settings
from slgaussian.benchmark.baselines import ROWS, Row
from slgaussian.errors import InputError, did_you_mean
from slgaussian.parts.identity import places
from slgaussian.storage.store import ArtifactRef
from tasks.shard import Chain, Step, given

STAGE = "baselines"
OURS = "slgaussian"


def chosen(names: Sequence[str]) -> dict[str, Row]:
    """The rows of the table of methods by these names, in its order; ``all`` stands for all.

    Without our own, which is scored anyway.

    Raises
    ------
    InputError
        If there is no such method.
    """
    for name in names:
        if name not in (*ROWS, "all"):
            raise InputError(
                f"against: found {name!r}, expected all, or of these: {'; '.join(ROWS)}"
                f"{did_you_mean(name, ROWS)}"
            )
    return {
        name: row
        for name, row in ROWS.items()
        if name != OURS and (name in names or "all" in names)
    }


def chains(
    settings: Settings,
    scenes: Sequence[SceneSettings],
    refs: Mapping[str, Mapping[str, ArtifactRef]],
) -> list[Chain]:
    """A chain of one step a method and scene, of the scenes that have ``refs`` of their stages."""
    rows = chosen(settings.against)
    parts = settings.part_settings()
    where = places(parts.get(settings.encoder, {}))
    for part in (settings.proposer, settings.lifting):
        for key, place in places(parts.get(part, {})).items():
            where[f"{part}.{key}"] = place
    made = []
    for scene in scenes:
        if scene.name not in refs:
            continue
        for name, row in rows.items():
            rules = {**settings.rules(), **row.rules}
            called = {"method": name, "of": row.method, "own": dict(row.settings)}
            step = Step(
                STAGE,
                {**called, "rules": rules, **scene.asked},
                {"sample": "ingest", "truth": "truth", "labels": "masks", "field": "field"},
                where,
            )
            own = dict(refs[scene.name])
            chain = chain_name(scene.name, name)
            made.append(Chain(chain, partial(given, [step]), own, STAGE))
    return made


def chain_name(scene: str, method: str) -> str:
    """What the chain of a method and scene is called, in failures too."""
    return f"{scene}: {method}"
