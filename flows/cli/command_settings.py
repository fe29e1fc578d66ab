"""Which settings each command takes, and the headings under which commands are listed."""

from flows.settings import files_of, tables_of
from slgaussian.parts.registry import KINDS

RULES = ("protocol", "threshold", "share", "temperature", "canonical", "absent")
METHOD = (
    "size", "near", "far", "trust_cameras", *KINDS, "replicas", *RULES, "seed", "keep", "bank",
    *tables_of(),
)  # fmt: skip
PLACES = files_of("encoder")
FILES = (*(kind for kind in KINDS if files_of(kind)), *files_of(*KINDS))
BUILD = ("preset", *(name for name in METHOD if name not in RULES))
RUN = ("preset", *METHOD, "store", "runner", "workers", "method")
INGEST = (
    "min_overlap", "max_overlap", "min_baseline", "max_baseline", "max_blur", "max_clipped",
    "most", "store", "runner", "workers",
)  # fmt: skip
LABEL = ("predictor", "proposer", "tracker")
SUPERVISE = ("size", "near", "far", *LABEL, "replicas", "seed", *tables_of(*LABEL), *INGEST)
MASKS = (
    "preset", "size", "near", "far", "trust_cameras", *LABEL, "replicas", "seed",
    *tables_of(*LABEL),
)  # fmt: skip
TRAIN = ("steps", "rate", "corrupted", "held_out", "codes", "seed")

PARTS = (*LABEL, "encoder")
ENGINE = ("store", "runner", "workers")
COMMON = {
    "demo": ("preset", "size", *PARTS, "seed", *ENGINE),
    "benchmark": (
        "data",
        "pairs",
        "labels",
        "rooms",
        "views",
        "preset",
        "encoder",
        "seed",
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
    "train": ("steps", "rate", "codes", "seed", "store"),
    "retrain": ("chunks", "out", "models", "steps", *PARTS[:2], "seed", "store"),
    "doctor": ("store", "runner", *PARTS, "lifting"),
}
"""The settings that most people need of a command: `--help` shows these, `--help-all` the rest."""

FIELDS, SCORES = "Build a field and ask it", "Score it"
CORPORA, UPKEEP = "Learn from many scenes", "Look after an installation"
"""The headings of the commands."""
