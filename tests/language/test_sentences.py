"""What is read of a text that says where things are, and that nothing is read into any other."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.language.sentences import (
    NUMBERS,
    PART,
    PARTS,
    RELATIONS,
    SUPERLATIVES,
    Sentence,
    parse,
)
from slgaussian.language.vocabulary import load_vocabulary

CLASSES = Path(__file__).parents[2] / "benches" / "language" / "class_names.toml"

ASKING = {"of", "nearest", "closest", "farthest", "furthest"}
ASKING |= {word for ways in (*SUPERLATIVES.values(), *RELATIONS.values()) for word in ways}
ASKING |= {"how", "in", "next", "close", "left", "right", *NUMBERS}


def read(sentence):
    """All that is read, as a tuple: noun, relation, what to, superlative, count."""
    anchor = sentence.anchor and read(sentence.anchor)
    return sentence.noun, sentence.relation, anchor, sentence.superlative, sentence.count


def noun(text):
    return text, "", None, "", None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("chair left of the lamp", ("chair", "left of", noun("lamp"), "", None)),
        ("Chair to the LEFT of a lamp!", ("chair", "left of", noun("lamp"), "", None)),
        ("mug on the right side of the box", ("mug", "right of", noun("box"), "", None)),
        ("mug on the left of it", None),
        ("lamp over the sofa", ("lamp", "above", noun("sofa"), "", None)),
        ("box under the wooden table", ("box", "below", noun("wooden table"), "", None)),
        ("cup on top of the box", ("cup", "on", noun("box"), "", None)),
        ("ball standing on the box", ("ball", "on", noun("box"), "", None)),
        ("bag close to the door", ("bag", "next to", noun("door"), "", None)),
        ("chair by the window", ("chair", "next to", noun("window"), "", None)),
        ("chair that is behind the table", ("chair", "behind", noun("table"), "", None)),
        ("plant in front of my desk", ("plant", "in front of", noun("desk"), "", None)),
        ("the chair nearest the door", ("chair", "nearest to", noun("door"), "", None)),
        ("ball farthest from the box", ("ball", "farthest from", noun("box"), "", None)),
        ("the biggest red chair", ("red chair", "", None, "largest", None)),
        ("leftmost ball", ("ball", "", None, "leftmost", None)),
        ("closest box", ("box", "", None, "nearest", None)),
        ("two red chairs", ("red chairs", "", None, "", 2)),
        ("the 12 books", ("books", "", None, "", 12)),
        ("two largest balls", ("balls", "", None, "largest", 2)),
        ("how many chairs are there", ("chairs", "", None, "", 0)),
        (
            "How many cups are on the red table?",
            ("cups", "on", noun("red table"), "", 0),
        ),
        (
            "largest cup on the table next to the lamp",
            ("cup", "on", ("table", "next to", noun("lamp"), "", None), "largest", None),
        ),
        (
            "box beside the largest ball",
            ("box", "next to", ("ball", "", None, "largest", None), "", None),
        ),
        ("cup on the table on the left", ("cup", "on", noun("table on the left"), "", None)),
        ("leg of the chair", ("leg", PART, noun("chair"), "", None)),
        ("the fox's tail", ("tail", PART, noun("fox"), "", None)),
    ],
)  # fmt: skip
def test_what_is_read(text, expected):
    if expected is None:
        expected = ("mug", "left of", noun("it"), "", None)
        assert parse(text).plain or read(parse(text)) == expected
        return
    assert read(parse(text)) == expected
    assert not parse(text).problem


@pytest.mark.parametrize(
    "text",
    [
        "red ball",
        "lamp on the floor",
        "picture on the wall",
        "door on the left",
        "on the table",
        "left of the lamp",
        "picture of a plant",
        "chest of drawers",
        "head of lettuce",
        "men's shoes",
        "a painting by Rembrandt",
        "switch on",
        "largest",
        "two",
        "how many",
        "100 chairs",
        "two seat sofa",
        "2 liter glass",
        "one chair",
        "cup with a handle",
        "flower in a vase",
        "",
        "!?",
    ],
)
def test_a_text_without_such_words_is_itself(text):
    assert parse(text) == Sentence(text, text)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("largest leftmost chair", "only one of largest and leftmost"),
        ("how many largest chairs", "nothing to count"),
        ("largest chair nearest to the door", "chooses one of several"),
        ("chair between us and left of two lamps", "one thing here, not several"),
        ("cup on the table behind two lamps", "one thing here, not several"),
    ],
)
def test_what_cannot_be_answered_has_its_reason(text, problem):
    assert problem in parse(text).problem


def test_no_thing_and_no_class_of_public_sets_is_divided():
    known = load_vocabulary()
    asked = {way for ways in SUPERLATIVES.values() for way in ways}
    for spelling in {*known.words, *(" ".join(phrase) for phrase in known.phrases)} - asked:
        assert parse(spelling).plain, spelling
        assert parse(f"the red {spelling}").plain, spelling
    for names in tomllib.loads(CLASSES.read_text()).values():
        for name in names:
            assert parse(name).plain, name


@given(st.text())
def test_any_text_is_read(text):
    sentence = parse(text)
    assert sentence.text == text
    assert sentence.plain == (sentence == Sentence(text, text))


words = st.sampled_from(
    sorted({w for way in ASKING for w in way.split()} | PARTS)
    + ["the", "a", "red", "chair", "lamp", "fox's", "table", "not", "floor", "2", "are"]
)


@given(st.lists(words, max_size=9))
def test_any_words_are_read_and_none_is_made_up(several):
    text = " ".join(several)

    def check(sentence):
        assert sentence.plain or set(sentence.noun.split()) <= {
            one for word in text.split() for one in (word, word.removesuffix("'s"))
        }
        assert (sentence.anchor is None) == (sentence.relation == "")
        assert sentence.relation in ("", PART, *RELATIONS)
        assert sentence.superlative in ("", *SUPERLATIVES)
        if sentence.anchor is not None:
            assert sentence.noun
            assert len(sentence.anchor.text) < len(sentence.text)
            check(sentence.anchor)

    check(parse(text))


known = sorted({*load_vocabulary().words, "quixotic", "and", "with", "a"} - set(ASKING))


@given(st.lists(st.sampled_from(known), min_size=1, max_size=5))
def test_texts_of_other_words_are_themselves(several):
    assert parse(" ".join(several)).plain
