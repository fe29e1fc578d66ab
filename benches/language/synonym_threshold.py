"""What a sentence model makes of words that the lexicon does not know, by the bound on similarity.

python -m benches.language.synonym_threshold MODEL DATA

MODEL is a folder of all-MiniLM-L6-v2, DATA one with ``clip_text``. Each synonym in the lexicon is
held out in turn and looked up among all other spellings: how many are taken for a word, and how
many of these for the right one. Then words that the lexicon does not know: nouns of LVIS, some of
which do have a counterpart, and words for what cannot be seen.
"""

import argparse
from pathlib import Path

import numpy as np

from benches.common.pages import page
from benches.common.photograph_pairs import data_folder
from slgaussian.errors import InputError
from slgaussian.language.synonyms import LEAST, Synonyms
from slgaussian.language.vocabulary import Vocabulary, load_vocabulary

UNSEEN = [
    "democracy", "yesterday", "seven", "running", "happiness", "law", "music", "tuesday",
    "opinion", "travel", "algorithm", "history", "economy", "language", "hope", "quickly",
    "because", "noise", "energy", "idea", "justice", "mathematics", "theory", "winter",
    "monday", "success", "government", "marriage", "election", "science", "price", "silence",
]  # fmt: skip


def known(vocabulary: Vocabulary, word: str) -> bool:
    try:
        return not vocabulary.read(word).unknown
    except InputError:
        return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("data", type=data_folder("clip_text/lvis_names_clip_text.npz"))
    given = parser.parse_args()
    vocabulary = load_vocabulary()
    finder = Synonyms(given.model, vocabulary.words)
    spellings = list(finder.known)
    names = np.array([word.name for word in finder.known.values()])
    table = finder.encode(spellings)
    alike = table @ table.T
    np.fill_diagonal(alike, -1)
    held_out = np.array(spellings) != names
    best, right = alike.max(1)[held_out], (names[alike.argmax(1)] == names)[held_out]
    lvis = np.load(given.data / "clip_text" / "lvis_names_clip_text.npz")["names"]
    nouns = [str(n) for n in lvis if str(n).isalpha() and not known(vocabulary, str(n))]
    of_nouns, of_unseen = ((finder.encode(w) @ table.T).max(1) for w in (nouns, UNSEEN))
    rows = [
        {
            "least": least,
            "taken": (best >= least).mean(),
            "right": right[best >= least].mean(),
            "nouns": (of_nouns >= least).mean(),
            "unseen": (of_unseen >= least).mean(),
        }
        for least in (0.5, 0.55, 0.6, 0.65, 0.7, 0.75)
    ]
    taken = [(str(word), *finder.nearest(word)) for word in nouns if finder.nearest(word)]
    found = page(
        "language/synonym_threshold.md.j2",
        rows=rows,
        synonyms=int(held_out.sum()),
        nouns=len(nouns),
        unseen=len(UNSEEN),
        least=LEAST,
        taken=[f"{word} for {other.name} ({alike:.2f})" for word, other, alike in taken],
    )
    print(found)


if __name__ == "__main__":
    main()
