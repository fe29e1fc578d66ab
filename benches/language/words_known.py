"""Share of class names of public data sets that the lexicon rejects, or understands in part.

    python -m benches.language.words_known DATA [-o docs/measured]

Names of COCO, COCO-stuff and ADE20K are in ``class_names.toml``; DATA holds
``clip_text``, which has those of LVIS.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benches.common.harness import parser, publish, table
from benches.common.photograph_pairs import data_folder
from slgaussian.errors import InputError
from slgaussian.language.vocabulary import NOUN_FAMILIES, Vocabulary, load_vocabulary

LVIS = "clip_text/lvis_names_clip_text.npz"
TITLES = {"coco": "COCO", "coco_stuff": "COCO-stuff", "ade20k": "ADE20K 150", "lvis": "LVIS"}


def class_names(data: Path) -> dict[str, list[str]]:
    """Return the names by set, without the parentheses of LVIS and the leftovers of COCO-stuff."""
    lists = tomllib.loads((Path(__file__).parent / "class_names.toml").read_text("utf-8"))
    names = np.load(data / LVIS)["names"]
    lists["lvis"] = [re.sub(r"\(.*?\)", "", str(name)).replace("_", " ").strip() for name in names]
    return lists


def count(title: str, vocabulary: Vocabulary, names: Sequence[str]) -> dict[str, object]:
    """Return the shares of names that are rejected, or understood in part."""
    refused, in_part, no_thing = [], 0, 0
    for name in names:
        try:
            read = vocabulary.read(name)
        except InputError:
            refused.append(name)
            continue
        if read.unknown:
            in_part += 1
        elif not any(word.family in NOUN_FAMILIES for word in read.words):
            no_thing += 1
    shares = {"refused": len(refused), "part": in_part, "no_thing": no_thing}
    row = {"set": title, "names": len(names), "which": ", ".join(refused)}
    return row | {name: count / len(names) for name, count in shares.items()}


COLUMNS = {
    "set": ("set", str),
    "names": ("names", "d"),
    "refused": ("refused", ".1%"),
    "part": ("in part", ".1%"),
    "no_thing": ("no thing", ".1%"),
}


def main() -> None:
    arguments = parser(__doc__, "words.md")
    arguments.add_argument("data", type=data_folder(LVIS))
    args = arguments.parse_args()
    vocabulary = load_vocabulary()
    nouns = len({word.name for word in vocabulary.words.values() if word.family in NOUN_FAMILIES})
    rows = [count(TITLES[key], vocabulary, names) for key, names in class_names(args.data).items()]
    publish(
        args.out,
        "words.md",
        "python -m benches.language.words_known DATA",
        f"The lexicon has {nouns} nouns, in {len(vocabulary.words)} spellings of all words.",
        table(rows, COLUMNS),
        *(f"Refused of {row['set']}: {row['which']}." for row in rows if row["which"]),
    )


if __name__ == "__main__":
    main()
