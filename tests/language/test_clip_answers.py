"""Questions that any real CLIP answers: what random weights say, and what one that knows says."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("transformers")

from small_clip import WORDS, save_clip

from slgaussian.errors import InputError
from slgaussian.language import clip_answers, load_encoder
from slgaussian.language.clip import Clip
from slgaussian.parts.finding import Finding

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def random_clip(tmp_path_factory) -> Clip:
    return Clip(save_clip(tmp_path_factory.mktemp("clip")))


def by_question(found) -> dict[str, Finding]:
    return {finding.said.split(":")[0].split()[0]: finding for finding in found}


def test_random_weights_compute_rightly_and_know_nothing(random_clip):
    found = by_question(clip_answers.findings(random_clip))
    assert found["vectors"].good is True
    for question, skill in {
        "words": "know what words mean",
        "colours": "tell colours apart",
        "digits": "read drawn digits",
        "photographs": "know what photographs show",
    }.items():
        finding = found[question]
        assert finding.good is False
        said = f"expected {clip_answers.EXPECTED[question]}; its weights do not {skill}: are these"
        assert said in finding.said
    assert found["cost"].good is None and " s an image of 60 regions" in found["cost"].said


class ColourNames:
    """Tells pictures by the colour that is not grey, and texts by the colour that they name."""

    def encode_regions(self, image, masks):
        inks = np.array(list(clip_answers.COLOURS.values()))
        found = []
        for mask in masks:
            own = image[mask].astype(int)
            votes = (np.abs(own[:, None] - inks).sum(2) < 30).sum(0)
            found.append(np.eye(len(inks))[votes.argmax()])
        return np.array(found, np.float32)

    def encode_text(self, texts):
        names = list(clip_answers.COLOURS)
        return np.eye(len(names), dtype=np.float32)[[names.index(t.split()[1]) for t in texts]]


def test_one_that_knows_colours_has_them_all_right():
    squares = [clip_answers.square(rgb) for rgb in clip_answers.COLOURS.values()]
    texts = [f"a {name} square" for name in clip_answers.COLOURS]
    found = clip_answers._quiz(ColourNames(), "colours", squares, texts, "tell colours apart")
    assert found.good is True and found.said.startswith("colours: 8 of 8 ")
    assert "random" not in found.said
    turned = clip_answers._quiz(
        ColourNames(), "colours", squares, texts[::-1], "tell colours apart"
    )
    assert turned.good is False and "colours: 0 of 8 " in turned.said


def test_pictures_are_what_the_encoder_sees(random_clip):
    """Regions of one tall image are the pictures, each by itself."""
    pictures = [clip_answers.drawn_digit(3), clip_answers.photograph("coffee")]
    whole = np.ones((1, clip_answers.SIDE, clip_answers.SIDE), bool)
    alone = [random_clip.encode_regions(picture, whole)[0] for picture in pictures]
    assert np.abs(clip_answers.encode_pictures(random_clip, pictures) - alone).max() < 1e-6


def test_pictures_differ_and_fill_their_frame():
    drawn = [clip_answers.drawn_digit(k) for k in range(10)]
    drawn += [clip_answers.square(rgb) for rgb in clip_answers.COLOURS.values()]
    drawn += [clip_answers.photograph(name) for name in clip_answers.PHOTOGRAPHS]
    side = clip_answers.SIDE
    assert all(one.shape == (side, side, 3) and one.dtype == np.uint8 for one in drawn)
    assert len({one.tobytes() for one in drawn}) == len(drawn)
    assert all(np.ptp(one) > 100 for one in drawn)


def test_a_real_clip_knows_what_words_mean(real_data):
    """Of which EXPECTED["words"] was set: the real one has all right."""
    table = real_data / "clip_text" / "lvis_names_clip_text.npz"
    if not table.is_file():
        pytest.skip("SLG_TEST_DATA has no folder clip_text")
    named = load_encoder("named", table=table)
    full = {str(name).split("_(")[0].replace("_", " "): name for name in np.load(table)["names"]}

    def vectors(texts):
        return named.encode_text([full[text.removeprefix("a ")] for text in texts])

    assert clip_answers.right_words(vectors) == len(clip_answers.LIKE)
    assert clip_answers._words(vectors).good is True


def test_letters_alone_do_not_pass():
    """Vectors of the pairs of letters of a text, as an untrained network goes by its tokens."""

    def letters(texts):
        vectors = np.zeros((len(texts), 27 * 27), np.float32)
        for vector, text in zip(vectors, texts, strict=True):
            plain = ["abcdefghijklmnopqrstuvwxyz ".index(letter) for letter in text]
            np.add.at(vector, [27 * i + j for i, j in pairwise(plain)], 1)
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)

    assert clip_answers._words(letters).good is False


def save_table(file, names, vectors):
    np.savez(file, names=np.array(names), features=vectors.astype(np.float16))
    return file


def test_a_table_is_of_this_model_or_another(random_clip, tmp_path):
    names = list(WORDS)
    own = save_table(
        tmp_path / "own.npz", names, random_clip.encode_text([f"a {name}" for name in names])
    )
    found = clip_answers._table(random_clip, own)
    assert found.good is True and "1.0000 to it: both are of one model" in found.said
    rng = np.random.default_rng(0)
    other = save_table(tmp_path / "other.npz", names, rng.normal(size=(len(names), 24)))
    found = clip_answers._table(random_clip, other)
    assert found.good is None and "is of another model" in found.said
    wide = save_table(tmp_path / "wide.npz", names, rng.normal(size=(len(names), 512)))
    assert "with 512 axes and not 24" in clip_answers._table(random_clip, wide).said
    with pytest.raises(InputError, match="cannot be read"):
        list(clip_answers.findings(random_clip, tmp_path / "none.npz"))


def test_a_lower_precision_is_compared(random_clip):
    lower = Clip(random_clip.model, precision="bfloat16")
    found = by_question(clip_answers.findings(lower))
    assert found["precision"].good is True and "by a cosine of up to" in found["precision"].said
    assert "precision" not in by_question(clip_answers.findings(random_clip))
