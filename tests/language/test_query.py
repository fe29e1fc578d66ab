"""Find, locate and segment on pictures whose objects are known."""

import numpy as np
import pytest
from drawn import BLUE, GREEN, GREY, HEIGHT, RED, WIDTH, ball, bank_of, box, photograph
from scipy import ndimage

from slgaussian.errors import InputError
from slgaussian.language.query import central_point, find, segment
from slgaussian.language.relevancy import relevancy

OBJECTS = [
    (ball(60, 60, 26), RED),
    (box(160, 70, 26), RED),
    (ball(260, 60, 26), BLUE),
    (ball(60, 180, 26), RED),
    (box(160, 180, 26), GREEN, "striped"),
]


@pytest.fixture(scope="module")
def scene(lexicon):
    image, ids = photograph(OBJECTS)
    return ids, bank_of([image], [ids], lexicon)


def test_finds_every_object_that_fits_and_no_other(scene, lexicon):
    ids, bank = scene
    hit = find("red ball", ids, bank, lexicon)
    assert {i for i, _ in hit.objects} == {1, 4}
    np.testing.assert_array_equal(hit.mask, np.isin(ids, [1, 4]))
    assert hit.score == hit.objects[0][1] > 0.5
    assert [score for _, score in hit.objects] == sorted((s for _, s in hit.objects), reverse=True)
    assert ids[hit.point[1], hit.point[0]] == hit.objects[0][0]
    assert hit.unknown == ()


def test_relevancy_is_one_number_an_object_and_zero_off_objects(scene, lexicon):
    ids, bank = scene
    hit = find("red ball", ids, bank, lexicon)
    texts = lexicon.encode_text(["red ball"]), lexicon.encode_text(lexicon.canonical)
    scores = relevancy(bank.features, bank.present, *texts)[0]
    assert hit.relevancy.dtype == np.float32
    np.testing.assert_array_equal(
        hit.relevancy, np.concatenate([[0], scores]).astype(np.float32)[ids]
    )


@pytest.mark.parametrize("temperature", [1.0, 10.0, 100.0, 1000.0])
def test_what_is_found_does_not_depend_on_temperature(scene, lexicon, temperature):
    ids, bank = scene
    for text in ("red ball", "red", "striped", "blue box", "object"):
        plain = find(text, ids, bank, lexicon)
        hit = find(text, ids, bank, lexicon, temperature=temperature)
        np.testing.assert_array_equal(hit.mask, plain.mask)
        assert hit.point == plain.point
        assert [i for i, _ in hit.objects] == [i for i, _ in plain.objects]


def test_a_threshold_takes_every_object_above_it(scene, lexicon):
    ids, bank = scene
    scores = [find("red ball", ids, bank, lexicon).relevancy[ids == i].max() for i in range(1, 6)]
    cut = float(np.sort(scores)[2] + np.sort(scores)[3]) / 2
    hit = find("red ball", ids, bank, lexicon, threshold=cut)
    assert {i for i, _ in hit.objects} == {i for i in range(1, 6) if scores[i - 1] > cut}
    assert not find("red ball", ids, bank, lexicon, threshold=0.999).mask.any()


def test_nothing_that_fits_gives_an_empty_mask_but_still_a_best_guess(scene, lexicon):
    ids, bank = scene
    hit = find("yellow", ids, bank, lexicon)
    assert hit.objects == ()
    assert not hit.mask.any()
    assert hit.score < 0.5
    assert ids[hit.point[1], hit.point[0]] > 0


def test_no_object_in_the_image_gives_nothing(scene, lexicon):
    ids, bank = scene
    hit = find("red ball", np.zeros_like(ids), bank, lexicon)
    assert hit.point is None
    assert hit.score == 0
    assert not hit.mask.any()
    assert not hit.relevancy.any()
    assert not segment(["red"], np.zeros_like(ids), bank, lexicon).any()


def test_objects_that_are_not_visible_are_not_answers(scene, lexicon):
    ids, bank = scene
    hit = find("red ball", np.where(ids == 1, 0, ids), bank, lexicon)
    assert {i for i, _ in hit.objects} == {4}


def test_one_object_is_found_and_identical_objects_are_all_found(lexicon):
    image, ids = photograph([(ball(100, 100, 30), RED)])
    hit = find("red ball", ids, bank_of([image], [ids], lexicon), lexicon)
    assert hit.objects[0][0] == 1
    np.testing.assert_array_equal(hit.mask, ids == 1)
    twins = [(ball(40 + 60 * k, 120, 20), GREEN) for k in range(5)]
    image, ids = photograph(twins)
    hit = find("green ball", ids, bank_of([image], [ids], lexicon), lexicon)
    assert {i for i, _ in hit.objects} == {1, 2, 3, 4, 5}


def test_segment_gives_each_object_its_best_text(scene, lexicon):
    ids, bank = scene
    texts = ["blue ball", "red box", "red ball", "green striped box"]
    expected = np.array([0, 3, 2, 1, 3, 4], np.int32)[ids]
    got = segment(texts, ids, bank, lexicon)
    assert got.dtype == np.int32
    np.testing.assert_array_equal(got, expected)
    # The first of equal texts wins.
    np.testing.assert_array_equal(segment([*texts, *texts], ids, bank, lexicon), expected)


def test_a_text_with_an_unknown_word_says_so_in_the_result(scene, lexicon):
    ids, bank = scene
    hit = find("red zeppelin ball", ids, bank, lexicon)
    assert hit.unknown == ("zeppelin",)
    assert {i for i, _ in hit.objects} == {1, 4}


def test_bad_input_is_refused(scene, lexicon):
    ids, bank = scene
    with pytest.raises(InputError, match="object 9"):
        find("red", np.where(ids == 1, 9, ids), bank, lexicon)
    with pytest.raises(InputError, match="negative"):
        find("red", ids - 1, bank, lexicon)
    with pytest.raises(InputError, match="float64"):
        find("red", ids.astype(np.float64), bank, lexicon)
    with pytest.raises(InputError, match="no text"):
        segment([], ids, bank, lexicon)
    for threshold in (0, 1, np.nan, -0.2):
        with pytest.raises(InputError, match="threshold"):
            find("red", ids, bank, lexicon, threshold=threshold)
    for temperature in (0, np.nan):
        with pytest.raises(InputError, match="temperature"):
            find("red", ids, bank, lexicon, temperature=temperature)


def reference_point(region: np.ndarray) -> tuple[int, int]:
    """The definition of the located point, with SciPy's exact transforms."""
    components, _ = ndimage.label(region)  # 4-connected, numbered in row-major order
    largest = 1 + np.bincount(components.ravel())[1:].argmax()
    depth = ndimage.distance_transform_edt(np.pad(components == largest, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(depth.argmax(), depth.shape)
    return int(column), int(row)


def test_the_located_point_follows_its_definition_on_ragged_regions():
    rng = np.random.default_rng(11)
    for density in np.linspace(0.3, 0.95, 60):
        region = rng.random((31, 44)) < density
        assert central_point(region) == reference_point(region)


def test_the_located_point_of_known_regions():
    assert central_point(ball(100, 90, 20)) == (100, 90)
    # Of two equal squares the first in reading order; of its four middle pixels the first.
    region = np.zeros((20, 30), bool)
    region[10:14, 3:7] = region[2:6, 20:24] = True
    assert central_point(region) == (21, 3)
    # The edge of the image is a border: in a band along it the middle is taken, not the edge.
    band = np.zeros((9, 9), bool)
    band[:, :3] = True
    assert central_point(band) == (1, 1)
    # A ring is located on its body, not in its hole.
    ring = ball(100, 90, 20) & ~ball(100, 90, 12)
    x, y = central_point(ring)
    assert ring[y, x]


def test_grey_is_not_mistaken_for_the_background(lexicon):
    wall = np.zeros((HEIGHT, WIDTH), bool)
    wall[:120] = True
    image, ids = photograph([(wall, GREY), (ball(200, 180, 25), RED)])
    hit = find("grey wall", ids, bank_of([image], [ids], lexicon), lexicon)
    assert {i for i, _ in hit.objects} == {1}
