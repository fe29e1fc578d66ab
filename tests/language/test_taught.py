"""Words taught by example: content, scores, and file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.errors import InputError, SpecError
from slgaussian.language.answer import ask
from slgaussian.language.lexicon import Lexicon
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader
from slgaussian.language.taught import (
    BOUNDARY_LIKENESS,
    COSINE_SCALE,
    TaughtWords,
    encoder_identity,
)
from slgaussian.storage.encoding import decode_npz, encode_arrays
from slgaussian.storage.specs import load_spec
from tests.language.drawn import BLUE, GREEN, GREY, RED, ball, box, cone, make_bank, photograph

THIS = encoder_identity({"encoder": "lexicon"})
OTHER = encoder_identity({"encoder": "clip", "clip": {"model": "1f2e"}})
WIDTH = 12


def unit(seed: int, count: int = 1) -> np.ndarray:
    """Return unit vectors near each other, as features of regions are."""
    drawn = np.random.default_rng(seed).normal(size=(count, WIDTH)) * 0.1 + 1
    vectors = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    return vectors.astype(np.float32)


def taught(word: str = "fox", seed: int = 0, before: TaughtWords | None = None) -> TaughtWords:
    words = before or TaughtWords()
    return words.add_example(word, unit(seed)[0], unit(100 + seed, 6), THIS)


@pytest.fixture(scope="module")
def scene():
    """Two views of a red ball, a blue box, a green cone and a grey ball."""
    images, ids = [], []
    for x in (0, 6):
        objects = [(ball(60 + x, 80, 35), RED), (box(170 + x, 70, 30), BLUE, "striped")]
        objects += [(cone(250 + x, 160, 35), GREEN), (ball(90 + x, 180, 30), GREY)]
        image, labels = photograph(objects, seed=x)
        images.append(image)
        ids.append(labels)
    encoder = Lexicon()
    return ids[0], make_bank(images, ids, encoder), encoder


def feature(bank, row: int) -> np.ndarray:
    mean = bank.features[row].mean(0)
    return mean / np.linalg.norm(mean)


def reader(scene, *lessons: int, word: str = "zorp") -> BankReader:
    """Return a reader with a word taught by rows of the bank."""
    _, bank, encoder = scene
    words = TaughtWords()
    for row in lessons:
        rivals = np.stack([feature(bank, rival) for rival in range(len(bank)) if rival != row])
        words = words.add_example(word, feature(bank, row), rivals, THIS)
    return BankReader(bank, encoder, words)


def ask_once(scene, reader: BankReader, text: str = "zorp", **rules):
    ids, bank, _ = scene
    return ask([text], ObjectMap(ids, bank.ids), reader, Rules(**rules))[0]


@pytest.mark.parametrize("row", range(4))
def test_taught_word_finds_its_example(scene, row):
    hit = ask_once(scene, reader(scene, row), "  ZORP ")
    assert [id_ for id_, _ in hit.objects] == [row + 1]
    assert hit.score > 0.6
    assert hit.kind == "taught" and hit.understood.examples == 1
    other_scores = np.delete(hit.scores, row)
    assert other_scores.max() < 0.5


def test_taught_word_takes_precedence_over_the_encoder(scene):
    of_known_word = ask_once(scene, reader(scene), "blue")
    assert of_known_word.kind == "known" and of_known_word.objects[0][0] == 2
    hit = ask_once(scene, reader(scene, 2, word="blue"), "Blue")
    assert [id_ for id_, _ in hit.objects] == [3]
    assert (hit.kind, hit.understood.instead_of) == ("taught", "blue")
    assert ask_once(scene, reader(scene, 2)).understood.instead_of == ""
    assert ask_once(scene, reader(scene), "blue zorp").kind == "unknown"


def test_gaps_of_taught_and_known_texts_equal_those_of_each_alone(scene):
    taught_reader = reader(scene, 3)
    together = taught_reader.gaps(["red", "zorp", "green cone"], Rules())
    for text, gaps in zip(["red", "zorp", "green cone"], together, strict=True):
        np.testing.assert_array_equal(taught_reader.gaps([text], Rules())[0], gaps)


@given(st.lists(st.integers(0, 5), max_size=6), st.integers(0, 50))
def test_leads_are_highest_for_an_example(lessons, seed):
    words = TaughtWords()
    for number in {*lessons, 9}:
        words = words.add_example("fox", unit(number)[0], unit(200, 7), THIS)
    looks = np.concatenate([unit(seed + 300, 5), unit(9)]).astype(np.float64)
    leads = words.leads("fox", looks)
    assert leads.argmax() == 5 and leads[5] == pytest.approx(
        COSINE_SCALE * (1 - BOUNDARY_LIKENESS), abs=1e-4
    )
    assert (leads >= -2 * COSINE_SCALE).all()


def test_add_example_keeps_examples_distinct_and_out_of_rivals():
    rivals = unit(7, 4)
    words = TaughtWords().add_example("fox", unit(1)[0], rivals, THIS)
    assert words.add_example("Fox", unit(1)[0], rivals, THIS).examples("fox") == 1
    second = words.add_example("fox", rivals[2], np.concatenate([rivals[:2], unit(1)]), THIS)
    assert second.examples("fox") == 2
    assert len(second.lessons["fox"].rivals) == 3  # neither example, and no rival twice


def test_remove_leaves_nothing_of_a_word():
    words = taught("owl", 3, taught())
    assert list(words) == ["fox", "owl"] and "FOX" in words and "" not in words
    left = words.remove("fox")
    assert list(left) == ["owl"] and set(left.to_arrays()["rival_words"]) == {"owl"}
    assert left.remove("owl").to_arrays()["encoder"] == ""
    with pytest.raises(InputError, match=r"'fox': is no taught word; those there are: 'owl'"):
        left.remove("fox")


def test_arrays_restore_equal_words():
    words = taught("brass owl", 5, taught())
    data = encode_arrays(words.to_arrays(), load_spec("words"))
    restored = TaughtWords.from_arrays(decode_npz(data)[0], THIS)
    for name, array in words.to_arrays().items():
        np.testing.assert_array_equal(restored.to_arrays()[name], array)
    looks = unit(40, 3).astype(np.float64)
    np.testing.assert_array_equal(restored.leads("fox", looks), words.leads("fox", looks))
    assert encode_arrays(restored.to_arrays(), load_spec("words")) == data


def test_words_of_another_encoder_or_length_raise_errors():
    says = r'are of the encoder {"encoder": "lexicon"}, but this field.s is {"encoder": "clip"'
    with pytest.raises(InputError, match=says):
        TaughtWords.from_arrays(taught().to_arrays(), OTHER)
    with pytest.raises(InputError, match=says):
        taught().add_example("owl", unit(1)[0], unit(2, 2), OTHER)
    arrays = {**taught().to_arrays(), "rivals": np.ones((6, WIDTH), np.float16)}
    with pytest.raises(SpecError, match="no unit vector"):
        TaughtWords.from_arrays(arrays, THIS)
    for word in ("", "  ", "a" * 81):
        with pytest.raises(InputError, match="expected 1 to 80 letters"):
            taught(word)
