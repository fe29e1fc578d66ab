"""Vectors by name, and objects that get those of their true names."""

import pickle

import numpy as np
import pytest
from drawn import view_of

from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.datasets import load as load_scene
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.labels import LabelMaps
from slgaussian.language import load_encoder
from slgaussian.language.bank import build_bank
from slgaussian.language.named import ANY_NAME, true_names
from slgaussian.scene import Sample


def narrow(count: int, width: int = 64, seed: int = 0) -> np.ndarray:
    """Unit vectors float16 whose cosines lie about 0.75, as those of CLIP's texts do."""
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(count, width)) + 1.7
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float16)


def save(file, names, features=None):
    features = narrow(len(names)) if features is None else features
    np.savez(file, names=np.array(names), features=features)
    return file


NAMES = ["wine_glass", "bow_(decorative_ribbons)", "Teddy bear", "sofa", "ball"]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return save(tmp_path_factory.mktemp("table") / "names.npz", NAMES)


def test_a_text_is_the_name_that_it_spells(table):
    encoder = load_encoder("named", table=table)
    found = encoder.encode_text(["Wine  Glass", "wine_glass", "TEDDY_BEAR", " sofa\n"])
    assert found.dtype == np.float32
    assert np.array_equal(found[0], found[1])
    expected = narrow(5)[[0, 0, 2, 3]].astype(np.float64)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(found - expected).max() < 1e-7  # rounding to float32 of numbers below 1
    assert np.abs(np.linalg.norm(found, axis=1) - 1).max() < 1e-6
    assert encoder.unknown_words("sofa") == ()
    assert encoder.encode_text([]).shape == (0, 64)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("wine glas", "'wine glas': is no name of the table; .* like it are 'wine glass'"),
        ("", "is no name of the table"),
        ("Übergröße 球", "is no name of the table"),
        ("x" * 10_000, "is no name of the table"),
    ],
)
def test_another_text_is_refused_with_names_like_it(table, text, says):
    encoder = load_encoder("named", table=table)
    for ask in (lambda: encoder.encode_text(["sofa", text]), lambda: encoder.unknown_words(text)):
        with pytest.raises(InputError, match=says) as error:
            ask()
        assert "\n" not in str(error.value) and len(str(error.value)) < 250


def test_texts_compete_with_the_canonical_phrases_that_there_are(tmp_path):
    file = save(tmp_path / "a.npz", [*NAMES, "Things", "object"])
    assert load_encoder("named", table=file).canonical == ("object", "things")


def test_texts_compete_with_what_all_names_have_in_common(table):
    encoder = load_encoder("named", table=table)
    assert encoder.canonical == (ANY_NAME,)
    unit = narrow(5).astype(np.float64)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    mean = unit.mean(0) / np.linalg.norm(unit.mean(0))
    assert np.abs(encoder.encode_text([ANY_NAME])[0] - mean).max() < 1e-7


def wrong_share(vectors: np.ndarray, canonical: np.ndarray) -> float:
    """Pairs of different names of which one is taken for the other at a relevancy of 0.5."""
    cosines = vectors @ vectors.T
    taken = cosines > (vectors @ canonical.T).max(1, keepdims=True)
    return (taken.sum() - np.trace(taken)) / (len(vectors) * (len(vectors) - 1))


def test_any_name_keeps_real_names_apart(real_data):
    table = real_data / "clip_text" / "lvis_names_clip_text.npz"
    if not table.is_file():
        pytest.skip("SLG_TEST_DATA has no folder clip_text")
    encoder = load_encoder("named", table=table)
    names = [str(name) for name in np.load(table)["names"]]
    vectors = encoder.encode_text(names).astype(np.float64)
    anything = encoder.encode_text(encoder.canonical).astype(np.float64)
    assert wrong_share(vectors, anything) < 0.003
    for seed in range(3):
        four = np.random.default_rng(seed).choice(len(names), 4, replace=False)
        assert wrong_share(vectors, vectors[four]) > 0.05


@pytest.mark.parametrize(
    ("write", "says"),
    [
        (lambda f: None, "cannot be read"),
        (lambda f: f.write_bytes(b"<html>"), "is not a .npz with names and features"),
        (lambda f: np.savez(f, names=np.array(NAMES)), "is not a .npz with names and features"),
        (lambda f: np.savez(f, names=np.array(NAMES, object), features=narrow(5)), "is not a .npz"),
        (lambda f: save(f, NAMES, narrow(4)), r"found names <U24 \(5,\) and features float16 \(4"),
        (lambda f: save(f, NAMES, narrow(5).astype(int)), "features int64"),
        (lambda f: save(f, [1, 2], narrow(2)), "found names int64"),
        (lambda f: save(f, np.zeros(0, "U3"), np.zeros((0, 4))), "expected str"),
        (lambda f: save(f, ["a b", "A_b"], narrow(2)), "the name 'a b' is there twice"),
        (lambda f: save(f, ["a", "b"], narrow(2) * [[1], [0]]), "the vector of 'b' is zero or not"),
        (lambda f: save(f, ["a", "b"], narrow(2) * [[np.nan], [1]]), "the vector of 'a' is zero"),
    ],
)
def test_a_table_that_cannot_be_is_one_sentence(tmp_path, write, says):
    file = tmp_path / "names.npz"
    write(file)
    with pytest.raises(InputError, match=says) as error:
        load_encoder("named", table=file)
    assert "\n" not in str(error.value) and str(file) in str(error.value)


def test_no_code_of_a_table_is_run(tmp_path):
    mark = tmp_path / "was-here"

    class Trap:
        def __reduce__(self):
            return open, (str(mark), "w")

    (tmp_path / "names.npz").write_bytes(pickle.dumps(Trap()))
    with pytest.raises(InputError, match=r"is not a \.npz"):
        load_encoder("named", table=tmp_path / "names.npz")
    assert not mark.exists()


def test_without_a_table_it_says_what_to_give():
    with pytest.raises(InputError, match=r"named table: none given; .* --set named.table=FILE"):
        load_encoder("named")


def test_pixels_do_not_tell_a_name(table):
    encoder = load_encoder("named", table=table)
    with pytest.raises(InputError, match="does not look at images"):
        encoder.encode_regions(np.zeros((4, 4, 3), np.uint8), np.ones((1, 4, 4), bool))


def halves() -> tuple[Sample, LabelMaps]:
    """Two views, three things, and labels that do not quite agree with them."""
    rng = np.random.default_rng(0)
    instances = np.zeros((2, 8, 12), np.int32)
    instances[:, :, :4], instances[:, :, 4:8], instances[1, :, 8:] = 7, 3, 9
    labels = np.zeros((2, 8, 12), np.int32)
    labels[:, :, :5] = 1  # a column of 3 too many
    labels[:, :, 5:8] = 2
    labels[0, :, 8:] = 5  # nothing that has a name
    labels[1, :6, 8:] = 6
    images = rng.integers(0, 256, (2, 8, 12, 3), np.uint8)
    views = []
    for i, image in enumerate(images):
        view = view_of(image, f"view {i}")
        camera = type(view.camera)(view.camera.K, np.eye(4), 12, 8)
        camera.c2w[0, 3] = i
        views.append(type(view)(view.name, camera, image, None, instances[i]))
    phrases = {7: "sofa", 3: "ball", 9: "wine glass"}
    return Sample("s", tuple(views), (), phrases), LabelMaps(labels, np.ones(labels.shape))


def test_an_object_is_called_what_most_of_it_is():
    sample, maps = halves()
    assert true_names(sample, maps) == {1: "sofa", 2: "ball", 6: "wine glass"}


def test_a_bank_by_name_holds_what_the_table_says(table):
    sample, maps = halves()
    encoder = load_encoder("named", table=table)
    codes = np.linspace(0, 1, 12, dtype=np.float32).reshape(4, 3)
    bank = build_bank(sample.context, maps, encoder, codes, true_names(sample, maps))
    # What has no name is in no view, so no text finds it.
    assert bank.present.tolist() == [[1, 1], [1, 1], [0, 0], [0, 1]]
    expected = encoder.encode_text(["sofa", "ball", "sofa", "wine glass"])
    for v in range(2):
        held = bank.present[:, v]
        assert np.abs(bank.features[held, v] - expected[held]).max() < 2**-11  # stored as float16
    assert not bank.features[~bank.present].any()


def test_data_without_truth_cannot_be_named(table):
    sample, maps = halves()
    blind = tuple(type(v)(v.name, v.camera, v.image) for v in sample.context)
    for other in (Sample("s", blind, (), sample.phrases), Sample("s", sample.context)):
        with pytest.raises(InputError, match="told what objects are called, but these data do not"):
            true_names(other, maps)


def test_a_whole_field_by_name(tmp_path):
    room = load_scene("procedural", seed=1, objects=4, views=3, height=64, width=64)
    sample = room.sample(["view_00", "view_02"], near=0.8, far=12.0)
    names = sorted(set(sample.phrases.values()))
    table = save(tmp_path / "names.npz", names)
    own = {"named": {"table": table}}
    field = build_field(sample, Method(encoder="named", replicas=1, settings=own))
    field.save(tmp_path / "field")
    (tmp_path / "elsewhere").mkdir()
    moved = table.rename(tmp_path / "elsewhere" / "n.npz")
    with pytest.raises(InputError, match=r"is no longer at .*names\.npz; say where it is"):
        SemanticField.load(tmp_path / "field").query([names[0]], [sample.context[0].camera])
    loaded = SemanticField.load(tmp_path / "field", encoder={"table": moved})
    view = loaded.render(sample.context[0].camera)
    shown = [n for n in names if (view.query(n).scores > 0.5).any()]
    assert len(shown) >= 2
    with pytest.raises(InputError, match="is no name of the table"):
        view.query("unheard of")
    other = save(tmp_path / "other.npz", names, narrow(len(names), seed=1))
    with pytest.raises(InputError, match=r"other\.npz: is not what the field was built with"):
        SemanticField.load(tmp_path / "field", encoder={"table": other}).encoder  # noqa: B018
