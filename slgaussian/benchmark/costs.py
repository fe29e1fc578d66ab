"""What answers cost, by method: of the rows of the data spec ``times``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Cost:
    """What a method costs on a data set; None where it was not measured.

    Attributes
    ----------
    dataset, method : str
    cold_query, view_query, further_query : float or None
        Seconds of the first answer of a scene, of one in a new view of a scene that has answered
        before, and of one more in that view: medians over scenes, views and queries.
    prepare, build : float or None
        Seconds of a scene, for the method and for the field that all methods share: medians over
        scenes.
    grown, peak : int or None
        Bytes: the most that a scene added to what the process held before, and held in all.
    """

    dataset: str
    method: str
    cold_query: float | None
    view_query: float | None
    further_query: float | None
    prepare: float | None
    build: float | None
    grown: int | None
    peak: int | None


def costs_of(rows: Iterable[Mapping[str, Any]]) -> list[Cost]:
    """One a data set and method, in their order; rows may lack columns that are not known."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["dataset"], row["method"]), []).append(row)
    return [_cost(dataset, method, own) for (dataset, method), own in groups.items()]


def _cost(dataset: str, method: str, rows: list[Mapping[str, Any]]) -> Cost:
    frames = list({(row["scene"], row["frame"]): row for row in rows}.values())
    scenes = list({row["scene"]: row for row in rows}.values())

    def middle(of: list[Mapping[str, Any]], name: str) -> float | None:
        known = [row[name] for row in of if row.get(name) is not None]
        return median(known) if known else None

    held = [
        (row["peak_bytes"] - row["held_bytes"], row["peak_bytes"])
        for row in scenes
        if None not in (row.get("peak_bytes"), row.get("held_bytes"))
    ]
    return Cost(
        dataset,
        method,
        cold_query=middle(frames, "cold_seconds"),
        view_query=middle(frames, "view_seconds"),
        further_query=middle(rows, "query_seconds"),
        prepare=middle(scenes, "prepare_seconds"),
        build=middle(scenes, "build_seconds"),
        grown=max((grown for grown, _ in held), default=None),
        peak=max((peak for _, peak in held), default=None),
    )
