"""Unknown words for the lexicon: the known word that a sentence model finds nearest in meaning.

The model is a folder of sentence-transformers such as ``all-MiniLM-L6-v2`` (Reimers and Gurevych,
"Sentence-BERT", EMNLP 2019), loaded with ``transformers`` alone: a BERT whose token vectors are
averaged and made a unit vector.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from slgaussian.errors import InputError
from slgaussian.kernels.threads import inside
from slgaussian.language.vocabulary import NOUNS, Word
from slgaussian.parts.pretrained import (
    Family,
    find_model,
    load_pretrained,
    load_tokenizer,
    read_json,
)

FAMILIES = NOUNS | {"colour", "texture", "material"}
"""Families of the words that an unknown one may stand for. Sizes and places are left out: their
opposites ("leftmost" and "rightmost") are what such models find nearest."""

LEAST = 0.7
"""Similarity below which a word stays unknown (``benches/language/synonym_threshold.py``): half of
the lexicon's own synonyms, each looked up among all other spellings, reach it, and 63 % of those
mean the same. So do 5 of the 24 nouns of LVIS that the lexicon does not know, of which none is
right: an earplug is no hand. Therefore what a word is taken for is always said."""

BATCH = 64
MOST_TOKENS = 64
"""Tokens of a word that are looked at; what is longer is cut."""


class Synonyms:
    """Finds known words for unknown ones.

    Parameters
    ----------
    model : path or str
        Folder, or name on the Hugging Face hub.
    words : mapping str -> Word
        The known words by all their spellings.

    Attributes
    ----------
    known : mapping str -> Word
        Those of them that an unknown word may stand for.

    Raises
    ------
    InputError
        If the model averages otherwise, or as :func:`slgaussian.parts.pretrained.load_pretrained`
        and :func:`slgaussian.parts.pretrained.load_tokenizer`.
    """

    FAMILY: ClassVar[Family] = Family(
        "lexicon synonyms", "BertModel", ("bert",), "sentence-transformers/all-MiniLM-L6-v2"
    )

    def __init__(self, model: str | Path, words: Mapping[str, Word]) -> None:
        self._network = load_pretrained(model, self.FAMILY)
        folder = find_model(model).folder
        pooling = folder / "1_Pooling" / "config.json"
        said = read_json(pooling) if pooling.is_file() else {}
        if not said.get("pooling_mode_mean_tokens", True):
            raise InputError(
                f"{pooling}: the model does not average its tokens; give one that does, such as "
                f"{self.FAMILY.example}"
            )
        self._tokenizer = load_tokenizer(folder, "BertTokenizer")
        self.known = {s: w for s, w in words.items() if w.weights and w.family in FAMILIES}
        self.nearest = lru_cache(4096)(self._nearest)

    def _nearest(self, word: str) -> tuple[Word, float] | None:
        """The known word nearest to ``word`` and how alike they are, or None below LEAST."""
        similarities = self._table @ self.encode([word])[0]
        best = int(similarities.argmax())
        if similarities[best] < LEAST:
            return None
        return list(self.known.values())[best], float(similarities[best])

    @torch.inference_mode()
    def encode(self, words: Sequence[str]) -> np.ndarray:
        """Unit vectors float64 [N, C] of words."""
        vectors = []
        for start in range(0, len(words), BATCH):
            given = self._tokenizer(
                list(words[start : start + BATCH]),
                return_tensors="pt",
                padding=True,
                truncation=True,
                max_length=MOST_TOKENS,
            ).to(self._network.device)
            with inside(self._network):
                states = self._network(**given).last_hidden_state.double()
            # The mean but for a factor, which the unit length takes out.
            vectors.append((states * given["attention_mask"][..., None]).sum(1).cpu().numpy())
        found = np.concatenate(vectors)
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    @cached_property
    def _table(self) -> np.ndarray:
        return self.encode(list(self.known))
