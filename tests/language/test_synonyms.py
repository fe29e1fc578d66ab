"""Unknown words of the lexicon by a sentence model: here a tiny one that knows what it is told."""

import json
import shutil

import numpy as np
import pytest
import torch
import transformers
from small_bert import SAME, save_bert

from slgaussian.errors import InputError
from slgaussian.language import load_encoder
from slgaussian.language.synonyms import FAMILIES, LEAST, Synonyms
from slgaussian.language.vocabulary import load_vocabulary

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return save_bert(tmp_path_factory.mktemp("sentences") / "model")


@pytest.fixture(scope="module")
def lexicon_with(folder):
    return load_encoder("lexicon", synonyms=folder)


def test_words_are_encoded_as_transformers_does(folder):
    finder = Synonyms(folder, load_vocabulary().words)
    words = ["sofa", "chesterfield", "zzyzx", "red"]
    found = finder.encode(words)
    model = transformers.BertModel.from_pretrained(folder).double().eval()
    tokenizer = transformers.BertTokenizer.from_pretrained(folder)
    for word, vector in zip(words, found, strict=True):
        with torch.no_grad():
            states = model(**tokenizer(word, return_tensors="pt")).last_hidden_state[0]
        mean = states.mean(0).numpy()
        # float32 against float64: up to 2e-7 in any number.
        assert np.abs(vector - mean / np.linalg.norm(mean)).max() < 1e-6
    alone = np.concatenate([finder.encode([word]) for word in words])
    assert np.abs(alone - found).max() < 1e-6


def test_an_unknown_word_counts_as_the_nearest_known_one(lexicon_with, lexicon):
    text = "vermilion chesterfield"
    assert np.array_equal(lexicon_with.encode_text([text]), lexicon.encode_text(["red sofa"]))
    taken = lexicon_with.taken_for(text)
    assert list(taken) == ["vermilion", "chesterfield"]
    assert [other for other, _ in taken.values()] == ["red", "sofa"]
    assert all(abs(likeness - 1) < 1e-6 for _, likeness in taken.values())
    assert lexicon_with.unknown_words(text) == ()


def test_without_a_model_it_stays_unknown(lexicon):
    assert lexicon.unknown_words("vermilion sofa") == ("vermilion",)
    assert lexicon.taken_for("vermilion sofa") == {}


def test_known_words_are_not_asked_about(lexicon_with, lexicon):
    for text in ("red sofa", "striped boxes", "the scarlet loveseat on the left"):
        assert np.array_equal(lexicon_with.encode_text([text]), lexicon.encode_text([text]))
        assert lexicon_with.taken_for(text) == {}


def test_a_word_that_is_like_none_stays_unknown(folder, lexicon_with):
    finder = Synonyms(folder, load_vocabulary().words)
    rows = list(finder.known)
    similarity = max(finder.encode(rows) @ finder.encode(["qqqqzzzz"])[0])
    assert similarity < LEAST
    assert lexicon_with.unknown_words("qqqqzzzz ball") == ("qqqqzzzz",)
    with pytest.raises(InputError, match=r"none of its words can be used \(qqqqzzzz\)"):
        lexicon_with.encode_text(["qqqqzzzz"])


@pytest.mark.parametrize("word", ["portside", "midget"])
def test_no_word_is_taken_for_a_place_or_a_size(lexicon_with, word):
    """Their opposites are as near: it would be a guess."""
    assert {load_vocabulary().words[SAME[word]].family}.isdisjoint(FAMILIES)
    assert word in lexicon_with.unknown_words(f"{word} ball")


def test_what_is_left_out_anyway_is_not_said_to_be_taken(lexicon_with):
    assert tuple(lexicon_with.unused_words("ball on the chesterfield")) == ("on", "chesterfield")
    assert lexicon_with.taken_for("ball on the chesterfield") == {}
    # Nouns before the last one.
    assert lexicon_with.taken_for("chesterfield ball") == {}
    assert lexicon_with.unknown_words("chesterfield ball") == ("chesterfield",)


def broken(folder, target, how):
    shutil.copytree(folder, target)
    if how == "pooling":
        (target / "1_Pooling" / "config.json").write_text('{"pooling_mode_mean_tokens": false}')
    elif how == "no tokenizer":
        (target / "vocab.txt").unlink()
    elif how == "type":
        config = json.loads((target / "config.json").read_text())
        (target / "config.json").write_text(json.dumps({**config, "model_type": "t5"}))
    elif how == "cut":
        weights = target / "model.safetensors"
        weights.write_bytes(weights.read_bytes()[:-50])
    return target


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ("pooling", "does not average its tokens; give one that does, such as sentence-transf"),
        ("no tokenizer", "tokenizer .* holds none"),
        ("type", "is of type 't5', but lexicon synonyms needs 'bert'"),
        ("cut", "cannot be loaded as BertModel"),
    ],
)
def test_a_model_that_cannot_be_is_one_sentence(folder, tmp_path, how, says):
    with pytest.raises(InputError, match=says) as error:
        load_encoder("lexicon", synonyms=broken(folder, tmp_path / "model", how))
    assert "\n" not in str(error.value)


def test_no_folder_is_one_sentence():
    with pytest.raises(InputError, match="model no/such/model: there is no such folder"):
        load_encoder("lexicon", synonyms="no/such/model")
