"""A sentence model that is small enough for tests and knows what it is told."""

import zlib

import torch
import transformers

from slgaussian.language.vocabulary import load_vocabulary

SAME = {"chesterfield": "sofa", "vermilion": "red", "portside": "left", "midget": "small"}
"""Words that the model thinks the same as others."""


def save_bert(folder):
    """A sentence model: a word is a token, and those in SAME have the vector of the other one."""
    marks = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"]
    letters = [chr(i) for i in range(97, 123)]
    words = [word for word in load_vocabulary().words if word.isalpha()]
    tokens = list(
        dict.fromkeys([*marks, *words, *SAME, *letters, *(f"##{letter}" for letter in letters)])
    )
    config = transformers.BertConfig(
        vocab_size=len(tokens),
        hidden_size=64,
        num_hidden_layers=2,
        num_attention_heads=2,
        intermediate_size=48,
        max_position_embeddings=64,
    )
    torch.manual_seed(0)
    model = transformers.BertModel(config).eval().requires_grad_(False)
    table = model.embeddings.word_embeddings.weight
    for row, token in enumerate(tokens):
        seed = torch.Generator().manual_seed(zlib.crc32(SAME.get(token, token).encode()))
        table[row] = torch.randn(64, generator=seed)
    # What all words have in common cancels out, so that others are not alike.
    model.embeddings.position_embeddings.weight.zero_()
    model.embeddings.token_type_embeddings.weight.zero_()
    table[tokens.index("[SEP]")] = -table[tokens.index("[CLS]")]
    model.save_pretrained(folder)
    (folder / "vocab.txt").write_text("\n".join(tokens) + "\n")
    (folder / "1_Pooling").mkdir()
    (folder / "1_Pooling" / "config.json").write_text('{"pooling_mode_mean_tokens": true}')
    return folder
