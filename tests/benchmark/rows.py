"""Rows of the spec ``samples`` with default values."""

from slgaussian.storage.specs import load_spec

SETTINGS = {
    "dataset": "d",
    "frame": "f",
    "method": "m",
    "protocol": "slgaussian@2",
    "selection": "near-best",
    "temperature": 10.0,
    "share": 0.7,
    "canonical": "lerf",
    "absent": "skip",
    "note": "",
}


def sample(scene: str, query: str = "q", **columns: object) -> dict:
    """Return a row with all columns of the spec."""
    empty = dict.fromkeys(load_spec("samples").columns)
    return empty | SETTINGS | {"scene": scene, "query": query} | columns
