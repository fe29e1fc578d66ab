"""Nouns: which of the 1,000 classes of ImageNet a word means, by the tree of WordNet.

The table is made by ``benches/language/noun_table.py`` from WordNet 3.0, Copyright 2006 by
Princeton University, all rights reserved; ``noun_classes.LICENSE`` beside it is its licence.
"""

from __future__ import annotations

import lzma
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

TABLE = "noun_classes.txt.xz"
"""A line for each set of classes: their numbers, a tab, and the words that mean it."""


@cache
def noun_classes() -> Mapping[str, tuple[int, ...]]:
    """The classes of every noun of the table, of one to three words in lower case."""
    table: dict[str, tuple[int, ...]] = {}
    content = files(__package__).joinpath(TABLE).read_bytes()
    for line in lzma.decompress(content).decode().splitlines():
        numbers, words = line.split("\t")
        table |= dict.fromkeys(words.split(","), tuple(map(int, numbers.split())))
    return table
