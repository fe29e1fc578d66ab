"""Which settings each command takes, and the headings under which commands are listed."""

from collections.abc import Callable

from slgaussian.parts.registry import KINDS


def _tables(*kinds: str) -> Callable[[], tuple[str, ...]]:
    """The tables of the parts of these kinds, looked up when a command is looked at."""

    def named() -> tuple[str, ...]:
        from flows.settings import tables_of

        return tables_of(*kinds)

    return named


def _files(*kinds: str) -> Callable[[], tuple[str, ...]]:
    """Likewise the settings of these parts that are files."""

    def named() -> tuple[str, ...]:
        from flows.settings import files_of

        return files_of(*kinds)

    return named


def _with_files() -> tuple[str, ...]:
    """The kinds of parts some of which have files."""
    from flows.settings import files_of

    return tuple(kind for kind in KINDS if files_of(kind))


Names = tuple[str | Callable[[], tuple[str, ...]], ...]
"""Settings, and functions that name several."""

RULES: Names = ("protocol", "threshold", "share", "temperature", "canonical", "absent")
METHOD: Names = (
    "size", "near", "far", "trust_cameras", *KINDS, "replicas", *RULES, "seed", "keep", "bank",
    _tables(),
)  # fmt: skip
PLACES = (_files("encoder"),)
FILES = (_with_files, _files(*KINDS))
BUILD: Names = ("preset", *(name for name in METHOD if name not in RULES))
RUN: Names = ("preset", *METHOD, "store", "runner", "workers", "method")
INGEST = (
    "min_overlap", "max_overlap", "min_baseline", "max_baseline", "max_blur", "max_clipped",
    "most", "withdrawn", "store", "runner", "workers",
)  # fmt: skip
LABEL = ("predictor", "proposer", "tracker")
SUPERVISE: Names = ("size", "near", "far", *LABEL, "replicas", "seed", _tables(*LABEL), *INGEST)
MASKS: Names = (
    "preset", "size", "near", "far", "trust_cameras", *LABEL, "replicas", "seed",
    _tables(*LABEL),
)  # fmt: skip
DATASET: Names = (
    "size", "targets", "most", "max_unlabelled", "min_confirmed", "held_out", "images", "gaussians",
    "shard_mb", "near", "far", "trust_cameras", *LABEL, "encoder", "codes", "bank", "replicas",
    "seed", _tables(*LABEL, "encoder", "codes"), *(name for name in INGEST if name != "most"),
)  # fmt: skip
TRAIN = (
    "steps", "batch", "rate", "corrupted", "held_out", "widths", "hidden", "device", "threads",
    "readers", "codes", "seed",
)  # fmt: skip

PARTS = (*LABEL, "encoder")
ENGINE = ("store", "runner", "workers")
COMMON = {
    "demo": ("preset", "size", *PARTS, "seed", *ENGINE),
    "benchmark": (
        "data",
        "pairs",
        "labels",
        "rooms",
        "preset",
        *ENGINE,
    ),
    "run": ("preset", "seed", *ENGINE),
    "pairs": ("format", "min_overlap", "max_overlap", "min_baseline", "max_baseline"),
    "field": ("preset", "size", *PARTS),
    "masks": ("preset", "size", *PARTS[:3], "replicas"),
    "query": ("threshold",),
    "segment": ("threshold",),
    "objects": (),
    "export": (),
    "view": (),
    "extract": ("threshold",),
    "remove": ("threshold",),
    "ingest": ("min_overlap", "max_overlap", "most", *ENGINE),
    "supervise": ("size", *PARTS[:3], "most", *ENGINE),
    "dataset": ("size", "targets", "min_confirmed", "held_out", "gaussians", "store"),
    "train": ("steps", "batch", "rate", "architecture", "device", "seed", "store"),
    "retrain": ("chunks", "out", "models", "steps", *PARTS[:2], "seed", "store"),
    "nightly": ("store",),
    "doctor": ("store", "runner", *PARTS, "lifting"),
}
"""The settings that most people need of a command, which its help shows first."""

FIELDS, SCORES = "Build a field and ask it", "Score it"
CORPORA, UPKEEP = "Learn from many scenes", "Look after an installation"
"""The headings of the commands."""
