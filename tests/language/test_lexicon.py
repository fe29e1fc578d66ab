"""The lexicon: usable words, colours under different light, combined words."""

import tomllib
from collections import Counter
from importlib.resources import files

import numpy as np
import pytest
from drawn import (
    BLUE,
    GREEN,
    GREY,
    HEIGHT,
    RED,
    WHITE,
    WIDTH,
    ball,
    box,
    cone,
    find,
    make_bank,
    paint,
    photograph,
    segment,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from slgaussian.datasets.procedural.rooms import VOCABULARY as PROCEDURAL_WORDS
from slgaussian.errors import InputError
from slgaussian.geometry.room import Surroundings
from slgaussian.language import colours
from slgaussian.language.colours import ColourNames
from slgaussian.language.descriptors import Descriptors
from slgaussian.language.vocabulary import NOUN_FAMILIES, load_vocabulary

VOCABULARY = load_vocabulary()


def scores(lexicon, text: str, image: np.ndarray, masks: list[np.ndarray]) -> np.ndarray:
    """Cosine of a text with each region."""
    return lexicon.encode_regions(image, np.array(masks)) @ lexicon.encode_text([text])[0]


def test_words_and_their_plurals_encode_to_equal_unit_vectors(lexicon):
    for spelling, word in VOCABULARY.words.items():
        vector = lexicon.encode_text([spelling])[0]
        assert np.linalg.norm(vector) == pytest.approx(1, abs=1e-6), spelling
        np.testing.assert_array_equal(vector, lexicon.encode_text([word.name])[0])
        if not spelling.endswith("s") and spelling + "s" not in VOCABULARY.words:
            np.testing.assert_array_equal(vector, lexicon.encode_text([spelling + "s"])[0])


def test_words_use_every_measurement_and_no_other():
    names = set(Descriptors(ColourNames(VOCABULARY.colours), VOCABULARY.groups).names)
    assert {name for word in VOCABULARY.words.values() for name in word.weights} == names


def test_no_spelling_has_two_roles():
    vocabulary, nouns = (
        tomllib.loads(files("slgaussian.language").joinpath(name).read_text("utf-8"))
        for name in ("vocabulary.toml", "nouns.toml")
    )
    named = set(nouns.pop("naming"))
    roles = [*vocabulary["colours"], *vocabulary["neutral"], *vocabulary["stop"]]
    roles += [*vocabulary["relations"], *vocabulary["negations"]]
    for listed in (vocabulary["synonyms"], vocabulary["unseen"], vocabulary["phrases"]):
        roles += [spelling for several in listed.values() for spelling in several]
    for family in nouns.values():
        also = family.pop("also")
        assert set(also) <= set(family)
        roles += [*family, *(spelling for several in also.values() for spelling in several)]
        named -= set(family)
    for family in vocabulary["words"].values():
        roles += family
    assert [spelling for spelling, count in Counter(roles).items() if count > 1] == []
    assert named == set(), "things are told by nouns"
    assert {*nouns, "class"} == NOUN_FAMILIES


def test_understand_knows_all_words_of_procedural_scenes(lexicon):
    assert not any(lexicon.understand(word).unknown for word in PROCEDURAL_WORDS)


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("crimson ball", "red ball"),
        ("the red, red BALLS! red ball", "red ball"),
        ("grey-striped boxes", "gray striped box"),
        ("green plant", "quixotic green plant"),
        ("ｒｅｄ ｂａｌｌ", "red ball"),
        ("red\0ball", "red ball"),
        ("red ball " * 5_000, "red ball"),
    ],
)
def test_synonyms_encode_to_equal_vectors(lexicon, text, same):
    np.testing.assert_array_equal(*lexicon.encode_text([text, same]))


@pytest.mark.parametrize(
    ("text", "read_as", "unused", "unknown"),
    [
        ("red ball", "red ball", (), ()),
        ("red quixotic ball 🏀", "red ball", (), ("quixotic",)),
        ("красный red", "red", (), ("красный",)),
        ("the red 42 of it", "red", (), ("42", "it")),
        ("door escutcheon", "door", (), ("escutcheon",)),
        ("cup on the quixotic table", "cup", ("on", "quixotic", "table"), ()),
        # One thing is looked for.
        ("plant pot", "pot", (), ()),
        ("sofa cushion", "pillow", ("sofa",), ()),
        ("wooden door frame", "wooden frame", ("door",), ()),
        ("picture frame", "picture", (), ()),
        ("frame of the picture frame", "frame", ("picture",), ()),
        ("picture of a plant", "picture", ("plant",), ()),
        ("box of wood", "box wooden", (), ()),
        ("the red traffic light of the street", "red traffic light", ("street",), ()),
        ("two old wooden chairs", "wooden chair", ("two", "old"), ()),
        ("black and white cup on bed and chair", "black white cup", ("on", "bed", "chair"), ()),
        # Places count, and relations do not.
        ("red ball on the left", "red ball left", (), ()),
        ("picture on the wall", "picture hanging", (), ()),
        ("box standing on the floor next to the door", "box standing", ("next", "to", "door"), ()),
        ("cup on the table on the left", "cup", ("on", "table", "left"), ()),
        ("ball to the left of the door", "ball", ("to", "left", "door"), ()),
        ("on the floor", "standing", (), ()),
        ("left of the red ball", "left red ball", (), ()),
        ("cup on the left side", "cup left", (), ()),
        ("quixotic pair of shoes, quixotic", "shoe", (), ("quixotic",)),
        ("cup, small and old", "cup small", ("old",), ()),
    ],
)  # fmt: skip
def test_understand_reads_one_noun_and_its_descriptions(lexicon, text, read_as, unused, unknown):
    understood = lexicon.understand(text)
    assert understood.read_as == read_as
    assert tuple(understood.unused) == unused
    assert understood.unknown == unknown
    np.testing.assert_allclose(*lexicon.encode_text([text, read_as]), atol=1e-7)


@pytest.mark.parametrize(
    ("text", "noun", "classes"),
    [
        ("radiators", "radiators", {753, 811}),
        ("small red sofa", "sofa", {831}),
        ("abacus", "abacus", {398}),
        ("picture of a fox", "picture", set()),
        ("casket", "casket", {478, 492, 519, 637, 709, 771}),
        ("door escutcheon", "", set()),
        ("red", "", set()),
    ],
)
def test_read_returns_noun_and_imagenet_classes(lexicon, text, noun, classes):
    reading = VOCABULARY.read(text)
    assert (reading.noun, set(reading.classes)) == (noun, classes)
    assert lexicon.understand(text).classes == reading.classes


@pytest.mark.parametrize(
    ("texts", "sentence"),
    [
        (("zyzzyva", "on the table", "old", "красный мяч", "2"), "`slgaussian words` lists"),
        (("赤いボール", "r" * 100_000), "`slgaussian words` lists"),
        (("", " \t\n", "!? ..."), "found no word"),
        (("ball without stripes", "isn’t red", "not red"), "leave that part out"),
        (("beige building and tree", "a chair and a qwxyz", "cups and mugs"), "asks for two"),
    ],
)
def test_encode_text_raises_input_error_for_unusable_texts(lexicon, texts, sentence):
    for text in texts:
        with pytest.raises(InputError, match=sentence) as error:
            lexicon.encode_text(["red", text])
        assert text.split()[-1:] == [] or text.split()[-1][:40] in str(error.value)
        assert len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("text", "by_class", "sentence"),
    [
        ("biulding", True, "no word 'biulding' is known here; did you mean 'building'?"),
        ("red qwxyz", True, "no word 'qwxyz' is known here; teach it"),
        ("abacus", False, "'abacus' is told by the classifier alone"),
        ("abacus", True, ""),
        ("red", False, ""),
    ],
)
def test_understand_gives_a_reason_for_texts_it_cannot_answer(lexicon, text, by_class, sentence):
    reason = lexicon.understand(text, by_class).untold
    assert reason.startswith(sentence) and bool(reason) == bool(sentence)


def test_explain_lists_look_and_classes():
    is_known, reason = VOCABULARY.explain("red radiator")
    assert (
        is_known
        and "by its look" in reason
        and "by the classifier (2 classes of ImageNet)" in reason
    )
    alone = VOCABULARY.explain("abacus")[1]
    assert alone == "abacus, class: by the classifier (1 class of ImageNet)"
    is_known, reason = VOCABULARY.explain("yelow chair")
    assert not is_known and reason.endswith("; yelow is not known, did you mean 'yellow'?")
    assert VOCABULARY.explain("not red")[1].startswith("refused: ")


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=60))
def test_encode_text_gives_a_unit_vector_or_input_error(lexicon, text):
    try:
        vector = lexicon.encode_text([text])[0]
    except InputError as error:
        assert "query" in str(error)
    else:
        assert np.linalg.norm(vector) == pytest.approx(1, abs=1e-6)
        assert np.isfinite(vector).all()


def test_canonical_phrases_are_orthogonal_to_regions(lexicon):
    canonical = lexicon.encode_text(lexicon.canonical)
    image, ids = photograph([(ball(100, 100, 30), RED), (box(220, 100, 30), BLUE)])
    regions = lexicon.encode_regions(image, np.stack([ids == 1, ids == 2]))
    assert not (regions @ canonical.T).any()


FOCAL = {
    "red": (205, 30, 35),
    "orange": (245, 135, 25),
    "yellow": (240, 215, 50),
    "green": (45, 140, 60),
    "turquoise": (45, 180, 175),
    "blue": (40, 80, 190),
    "purple": (115, 50, 150),
    "pink": (240, 150, 180),
    "brown": (115, 70, 40),
    "beige": (215, 195, 155),
    "white": (240, 240, 238),
    "grey": (128, 128, 130),
    "black": (22, 22, 24),
}


@pytest.fixture(scope="module")
def names() -> ColourNames:
    return ColourNames(VOCABULARY.colours)


def under_light(rgb: tuple[int, int, int], share: float) -> np.ndarray:
    """Return the sRGB colour of a surface with its linear light scaled."""
    value = np.array(rgb) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4) * share
    srgb = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(np.clip(srgb, 0, 1) * 255).astype(np.uint8)


def test_colour_names_hold_in_the_shade(names):
    assert set(FOCAL) == set(names.names)
    for name, rgb in FOCAL.items():
        memberships = names(np.array(rgb, np.uint8))
        assert names.names[memberships.argmax()] == name
        assert memberships.max() > 0.6
    for name in ("red", "green", "blue", "purple"):
        for share in (0.85, 0.6, 0.35, 0.2, 0.1):
            assert names.names[names(under_light(FOCAL[name], share)).argmax()] == name


def test_memberships_equal_the_float64_reference(names):
    rgb = np.random.default_rng(1).integers(0, 256, (40, 3)).astype(np.uint8)
    # Cells of four steps are named by their middles.
    lab = colours.to_lab(((rgb[None] // 4 + 0.5) / 64).astype(np.float64))[0].astype(np.float64)
    lab[:, 0] *= colours.LIGHTNESS_WEIGHT
    nearest = np.stack(
        [((lab[:, None] - points) ** 2).sum(-1).min(1) for points in names._points], 1
    )
    closeness = np.exp(
        (nearest.min(1, keepdims=True) - nearest) / (2 * colours.TRANSITION_WIDTH**2)
    )
    plain = closeness / closeness.sum(1, keepdims=True)
    # Distances of up to 1e5 in float32 over 50: noise up to about 1e-4.
    np.testing.assert_allclose(names(rgb), plain, atol=3e-4)


ARRANGED = {
    "red ball": (ball(50, 60, 30), RED),
    "red striped ball": (ball(130, 60, 30), RED, "striped"),
    "blue striped ball": (ball(210, 60, 30), BLUE, "striped"),
    "red checked box": (box(280, 70, 28), RED, "checked"),
    "red box": (box(50, 180, 28), RED),
    "green dotted ball": (ball(130, 180, 32), GREEN, "dotted"),
    "green cone": (cone(210, 180, 30), GREEN),
    "blue box": (box(280, 180, 28), BLUE),
}


@pytest.fixture(scope="module")
def arrangement(lexicon):
    image, ids = photograph(list(ARRANGED.values()))
    return ids, make_bank([image], [ids], lexicon)


def test_query_ranks_the_object_with_all_attributes_first(lexicon, arrangement):
    ids, bank = arrangement
    for number, text in enumerate(ARRANGED, 1):
        assert find(text, ids, bank, lexicon).objects[0][0] == number
    # A vague text does not outbid a precise one that fits.
    vague = ["picture", "table", "shelf", "bag", "book", "cup"]
    got = segment([*vague, *ARRANGED], ids, bank, lexicon)
    expected = np.where(ids > 0, ids + len(vague), 0)
    np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("pattern", ["striped", "checked"])
def test_pattern_around_a_ring_has_positive_evidence(lexicon, pattern):
    image, _ = photograph([])
    y, x = np.mgrid[:HEIGHT, :WIDTH] - np.array([120, 160])[:, None, None]
    radius, sector = np.hypot(x, y), np.floor(np.arctan2(y, x) / np.pi * 8)
    ring = (radius > 48) & (radius < 90)
    second = (sector + (pattern == "checked") * np.floor(radius / 23)) % 2 == 1
    image[ring] = RED
    image[ring & second] = WHITE
    texts = ["red striped ring", "red checked ring", "red dotted ring", "red speckled ring"]
    best = max(texts, key=lambda text: scores(lexicon, text, image, [ring])[0])
    assert best == f"red {pattern} ring"
    assert scores(lexicon, best, image, [ring])[0] > 0.05


def test_sparse_specks_are_not_dots(lexicon):
    image, _ = photograph([])
    noise = np.random.default_rng(4).normal(size=(HEIGHT, WIDTH))
    smooth = ndimage.gaussian_filter(noise, 2)
    dotted, speckled = ball(90, 120, 32), box(230, 120, 60)
    paint(image, dotted, BLUE, "dotted")
    image[speckled] = BLUE
    image[speckled & (smooth > np.quantile(smooth, 0.9))] = WHITE
    image = ndimage.gaussian_filter(image, (0.7, 0.7, 0))
    dots, specks = (scores(lexicon, w, image, [dotted, speckled]) for w in ("dotted", "speckled"))
    assert dots[0] > dots[1]
    assert specks[1] > 0 > specks[0]


def test_a_picture_is_varied_where_a_pattern_is_not(lexicon):
    image, _ = photograph([])
    frame = np.zeros((HEIGHT, WIDTH), bool)
    frame[20:90, 20:110] = True
    rng = np.random.default_rng(7)
    scene = np.repeat(np.repeat(rng.integers(0, 256, (7, 9, 3), dtype=np.uint8), 10, 0), 10, 1)
    image[20:90, 20:110] = scene
    features = []
    for k, pattern in enumerate(["plain", "striped", "checked"]):
        features.append(np.roll(frame, 100 * k + 100, 1) if k < 2 else np.roll(frame, 110, 0))
        paint(image, features[-1], RED, pattern)
    picture, *rest = scores(lexicon, "picture", image, [frame, *features])
    assert picture > max(0, *rest)


def test_query_points_at_each_part_of_a_room(lexicon):
    area = np.zeros((HEIGHT, WIDTH), bool)
    ceiling, wall, floor, door = (area.copy() for _ in range(4))
    ceiling[:40], wall[40:150], floor[150:] = True, True, True
    door[60:150, 240:280] = True
    image, ids = photograph(
        [
            (ceiling, WHITE), (wall, GREY), (floor, (150, 105, 65)),
            (door, (25, 24, 26)), (ball(90, 200, 18), RED),
        ]
    )  # fmt: skip
    bank = make_bank([image], [ids], lexicon)
    texts = ["ceiling", "wall", "floor", "door", "ball"]
    for i, text in enumerate(texts, 1):
        hit = find(text, ids, bank, lexicon)
        assert ids[hit.point[1], hit.point[0]] == i, text


def test_words_for_places_select_left_right_and_middle(lexicon):
    masks = [ball(40, 60, 20), ball(160, 100, 20), ball(280, 60, 20)]
    image, _ = photograph([(mask, GREEN) for mask in masks])
    assert scores(lexicon, "ball on the left", image, masks).argmax() == 0
    assert scores(lexicon, "the rightmost ball", image, masks).argmax() == 2
    assert scores(lexicon, "ball in the middle", image, masks).argmax() == 1


def test_surroundings_separate_a_table_top_from_a_board_on_the_wall(lexicon):
    boards = [box(80, 60, 30), box(240, 180, 30)]
    image, _ = photograph([(mask, (150, 105, 65)) for mask in boards])
    height = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    level = np.zeros((HEIGHT, WIDTH), np.float32)
    level[boards[1]] = 1
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] / HEIGHT
    points = np.stack([columns, rows, 0 * rows], -1).astype(np.float32)
    masks = np.array(boards)
    features = lexicon.encode_regions(image, masks, Surroundings(points, height, level))
    unseen = lexicon.encode_regions(image, masks)
    unknown = Surroundings(*(np.full_like(a, np.nan) for a in (points, height, level)))
    table, hung = lexicon.encode_text(["table", "picture on the wall"])
    gain = (features - unseen) @ table
    assert gain[1] > gain[0] and (features @ hung)[0] > (features @ hung)[1]
    np.testing.assert_array_equal(lexicon.encode_regions(image, masks, unknown), unseen)


def test_regions_are_unit_vectors_down_to_one_pixel(lexicon):
    image, _ = photograph([(ball(100, 100, 30), RED)])
    masks = np.zeros((5, HEIGHT, WIDTH), bool)
    masks[0, 0, 0] = masks[1, -1, -1] = True
    masks[2, 17] = masks[3, :, 9] = True  # a row and a column
    masks[4] = True
    vectors = lexicon.encode_regions(image, masks)
    assert vectors.dtype == np.float32
    assert np.isfinite(vectors).all()
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6)


def test_encode_regions_does_not_depend_on_other_regions(lexicon):
    image, ids = photograph(list(ARRANGED.values()))
    masks = np.stack([ids == i for i in range(1, 9)])
    together = lexicon.encode_regions(image, masks)
    np.testing.assert_array_equal(together, lexicon.encode_regions(image, masks))
    alone = np.concatenate([lexicon.encode_regions(image, mask[None]) for mask in masks])
    np.testing.assert_array_equal(alone, together)
