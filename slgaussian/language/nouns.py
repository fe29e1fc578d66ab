"""Table from nouns to ImageNet classes, derived from the WordNet hierarchy.

``benches/language/noun_table.py`` makes the table from WordNet 3.0, Copyright 2006 by
Princeton University, all rights reserved; ``noun_classes.LICENSE`` beside it is its licence.
"""

from __future__ import annotations

import lzma
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

TABLE = "noun_classes.txt.xz"
"""One line per set of classes: their numbers, a tab, and its words."""


@cache
def noun_classes() -> Mapping[str, tuple[int, ...]]:
    """Read the table: classes by noun, which has one to three words in lower case."""
    table: dict[str, tuple[int, ...]] = {}
    content = files(__package__).joinpath(TABLE).read_bytes()
    for line in lzma.decompress(content).decode().splitlines():
        numbers, words = line.split("\t")
        table |= dict.fromkeys(words.split(","), tuple(map(int, numbers.split())))
    return table
