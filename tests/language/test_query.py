"""Queries and segmentation on pictures with known objects."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from drawn import (
    BLUE,
    GREEN,
    HEIGHT,
    RED,
    WIDTH,
    ball,
    box,
    cone,
    find,
    make_bank,
    make_view,
    photograph,
    relevancy,
    segment,
)

from slgaussian.errors import InputError
from slgaussian.labels import LabelMaps
from slgaussian.language.answer import ask
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.codes import grid_codes
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader

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
    return ids, make_bank([image], [ids], lexicon)


def test_query_selects_all_fitting_objects_only(scene, lexicon):
    ids, bank = scene
    hit = find("red ball", ids, bank, lexicon)
    assert {i for i, _ in hit.objects} == {1, 4}
    np.testing.assert_array_equal(hit.mask, np.isin(ids, [1, 4]))
    assert hit.score == hit.objects[0][1] > 0.5
    assert [score for _, score in hit.objects] == sorted((s for _, s in hit.objects), reverse=True)
    assert ids[hit.point[1], hit.point[0]] == hit.objects[0][0]
    assert hit.unknown == ()


def test_query_without_a_fitting_object_gives_an_empty_mask_and_a_point(scene, lexicon):
    ids, bank = scene
    hit = find("yellow", ids, bank, lexicon)
    assert hit.objects == () and not hit.mask.any() and hit.score < 0.5
    assert not hit.found and hit.verdict == "not here"
    assert ids[hit.point[1], hit.point[0]] > 0
    # In an image without objects there is not even a guess.
    nothing = find("red ball", np.zeros_like(ids), bank, lexicon)
    assert nothing.point is None and nothing.score == 0
    assert not nothing.mask.any() and not nothing.relevancy.any()
    assert not segment(["red"], np.zeros_like(ids), bank, lexicon).any()


def test_segment_gives_each_object_its_best_text(scene, lexicon):
    ids, bank = scene
    texts = ["blue ball", "red box", "red ball", "green striped box"]
    expected = np.array([0, 3, 2, 1, 3, 4], np.int32)[ids]
    got = segment(texts, ids, bank, lexicon)
    assert got.dtype == np.int32
    np.testing.assert_array_equal(got, expected)
    # The first of equal texts wins.
    np.testing.assert_array_equal(segment([*texts, *texts], ids, bank, lexicon), expected)


def test_segment_raises_input_error_without_a_list_of_texts(scene, lexicon):
    ids, bank = scene
    with pytest.raises(InputError, match="no text"):
        segment([], ids, bank, lexicon)
    with pytest.raises(InputError, match="found one text, expected a list"):
        segment("red", ids, bank, lexicon)


@pytest.mark.parametrize(
    ("rules", "sentence"),
    [
        ({"absent": "none"}, "absent: found 'none', expected one of skip, zero"),
        ({"threshold": 1}, "threshold"),
        ({"threshold": np.nan}, "threshold"),
        ({"threshold": -0.2}, "threshold"),
        ({"temperature": 0}, "temperature"),
        ({"temperature": np.nan}, "temperature"),
        ({"share": 0}, "share: found 0"),
        ({"share": 1.5}, "share: found 1.5"),
        ({"canonical": ""}, "canonical: found ''"),
        ({"canonical": []}, r"canonical: found \[\]"),
        ({"canonical": "object, , things"}, "none empty"),
    ],
)
def test_rules_raise_input_error_out_of_range(rules, sentence):
    with pytest.raises(InputError, match=sentence):
        Rules(**rules)


def test_share_bounds_the_gap_of_selected_objects(scene, lexicon):
    ids, bank = scene
    actual = [
        {i for i, _ in find("red", ids, bank, lexicon, share=share).objects}
        for share in (1.0, 0.9, 0.5, 0.01)
    ]
    assert len(actual[0]) == 1
    for fewer, extra in pairwise(actual):
        assert fewer <= extra
    # Nothing that fits worse than "object" is taken, however small the share.
    assert actual[-1] == {1, 2, 4}
    assert min(score for _, score in find("red", ids, bank, lexicon, share=0.01).objects) > 0.5


def test_canonical_phrases_by_name_and_by_list(scene, lexicon):
    ids, bank = scene
    of_own_phrases = find("red", ids, bank, lexicon)
    for same in ("lerf", "object, things,stuff , texture", ["object"], lexicon.canonical):
        hit = find("red", ids, bank, lexicon, canonical=same)
        np.testing.assert_array_equal(hit.scores, of_own_phrases.scores)
    # Against a rival that fits the same things better, little is left.
    against = find("red", ids, bank, lexicon, canonical=["object", "red ball"])
    texts = lexicon.encode_text(["red"]), lexicon.encode_text(["object", "red ball"])
    np.testing.assert_array_equal(against.scores, relevancy(bank.features, bank.present, *texts)[0])
    assert {i for i, _ in against.objects} == {2}
    with pytest.raises(InputError, match="zyzzyva"):
        find("red", ids, bank, lexicon, canonical="zyzzyva")


def test_reader_scores_both_absent_treatments(lexicon):
    image, ids = photograph([(ball(60, 120, 20), GREEN), (ball(160, 120, 20), RED)])
    alone = np.where(ids == 2, 0, ids)
    bank = make_bank([image, image], [ids, alone], lexicon)
    reader, object_map = BankReader(bank, lexicon), ObjectMap(ids, bank.ids)
    skip, zero = (
        ask(["green"], object_map, reader, Rules(absent=absent))[0].scores
        for absent in ("skip", "zero")
    )
    assert skip[1] < 0.5 == zero[1] and skip[0] == zero[0] > 0.5


def test_query_selects_all_objects_that_tie_for_the_best(lexicon):
    image, ids = photograph([(ball(60 + 100 * k, 120, 20), GREEN) for k in range(2)])
    bank = make_bank([image], [ids], lexicon)
    twins = MemoryBank(bank.ids, bank.codes, bank.features[[0, 0]], bank.present)
    hit = find("green", ids, twins, lexicon)
    assert [i for i, _ in hit.objects] == [1, 2]  # of equal ones the lowest id first
    assert ids[hit.point[1], hit.point[0]] == 1
    one = find("green", np.where(ids == 1, 0, ids), twins, lexicon)
    assert [i for i, _ in one.objects] == [2]


def test_query_selects_the_pieces_of_a_group(lexicon):
    """A quarter does not look like a ball, and the cones beside it fit no better."""
    image, labels = photograph(
        [(ball(80, 120, 42), BLUE), (cone(200, 80, 34), BLUE), (box(260, 180, 30), BLUE)]
    )
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    quarter = 4 + (x > 80) + 2 * (y > 120)
    ids = np.where(labels == 1, quarter, labels).astype(np.int32)
    maps = LabelMaps(ids[None], np.ones((1, HEIGHT, WIDTH), np.float32))
    codes = grid_codes(6, np.random.default_rng(0))
    groups = np.array([[0, 1, 2, 2, 2, 2]])
    bank = build_bank([make_view(image)], maps, lexicon, codes, groups=groups)
    hit = find("blue ball", ids, bank, lexicon)
    np.testing.assert_array_equal(hit.mask, labels == 1)
    assert labels[hit.point[1], hit.point[0]] == 1
    answers = segment(["box", "ball", "cone"], ids, bank, lexicon)
    np.testing.assert_array_equal(answers[labels > 0], np.array([0, 2, 3, 1])[labels[labels > 0]])
    alone = find("blue ball", ids, replace(bank, levels=None, group_features=None), lexicon)
    assert (alone.mask != (labels == 1)).any()


@pytest.fixture
def query_by_gaps(lexicon):
    """Return a function that queries "red" among objects with given gaps.

    Their ids are 1, 2, ...; each is larger than the one before; ``hidden`` ones are invisible.
    """
    red, *rivals = lexicon.encode_text(["red", *lexicon.canonical]).astype(np.float64)
    # Axes along which only the text, and nothing at all, says something.
    basis, _ = np.linalg.qr(np.stack([*rivals, red, np.arange(len(red))], 1))
    along, across = basis[:, -2] * np.sign(basis[:, -2] @ red), basis[:, -1]

    def query_with_gaps(*gaps: float, hidden: tuple[int, ...] = ()):
        share = np.array(gaps)[:, None] / (along @ red)
        features = (share * along + np.sqrt(1 - share**2) * across).astype(np.float32)[:, None]
        numbers = np.arange(1, len(gaps) + 1, dtype=np.int32)
        codes = grid_codes(len(gaps), np.random.default_rng(0))
        bank = MemoryBank(numbers, codes, features, np.ones((len(gaps), 1), bool))
        ids = np.repeat(numbers, 3 + numbers)[None].repeat(10, 0)
        ids[np.isin(ids, hidden)] = 0
        hit = find("red", ids, bank, lexicon)
        return [number for number, _ in hit.objects], int(ids[hit.point[1], hit.point[0]])

    return query_with_gaps


def test_query_selects_objects_with_six_tenths_of_the_best_gap(query_by_gaps):
    """Objects from 0.6 of the best gap are selected, from 0.9 pointed at; values by hand."""
    gaps = 0.5, 0.46, 0.31, 0.27, 0.0, -0.2
    assert query_by_gaps(*gaps) == ([1, 2, 3], 2)
    # The best is the best of what is seen: 0.27 is 0.87 of 0.31.
    assert query_by_gaps(*gaps, hidden=(1, 2)) == ([3, 4], 3)
    assert query_by_gaps(*gaps, hidden=(1, 2, 3)) == ([4], 4)
    # Fitting just as well as "object" does is no answer.
    assert query_by_gaps(*gaps, hidden=(1, 2, 3, 4))[0] == []
    assert query_by_gaps(-0.2, -0.1)[0] == []


def test_confidence_is_higher_for_present_and_connected_objects(scene, lexicon):
    ids, bank = scene
    present, absent = (find(text, ids, bank, lexicon) for text in ("blue box", "cup"))
    assert present.confidence.mask > absent.confidence.mask
    assert present.verdict == "found"
    # Of what is not among the objects at all.
    assert absent.verdict in ("not sure", "not here")
    # The temperature changes scores, not what is known.
    assert find("blue box", ids, bank, lexicon, temperature=1.0).confidence == present.confidence
    # Two balls apart are less sure than two that touch.
    joined = ids.copy()
    (y1, x1), (y4, x4) = (np.argwhere(ids == ball).mean(0).astype(int) for ball in (1, 4))
    joined[y1, min(x1, x4) : max(x1, x4) + 1] = 1
    joined[min(y1, y4) : max(y1, y4) + 1, x4] = 1
    separate, touching = (find("red ball", labels, bank, lexicon) for labels in (ids, joined))
    assert separate.confidence.mask < touching.confidence.mask


def test_confidence_is_none_for_custom_canonical_phrases(scene, lexicon):
    ids, bank = scene
    hit = find("red ball", ids, bank, lexicon, canonical="object")
    assert hit.confidence is None
    assert hit.uncalibrated == "canonical phrases of your own"
    assert hit.verdict == "found"
    assert find("red ball", ids, bank, lexicon).uncalibrated == ""


def test_gaps_use_the_soft_temperature_of_the_encoder(scene, lexicon, monkeypatch):
    """With a small temperature a group scores as its best view."""
    _, bank = scene
    every = np.full((1, len(bank)), len(bank), np.int32)
    grouped = replace(bank, levels=every, group_features=bank.features[:1])
    usual = BankReader(grouped, lexicon).gaps(["red ball"], Rules())
    monkeypatch.setattr(type(lexicon), "soft", 1e-4, raising=False)
    sharp = BankReader(grouped, lexicon).gaps(["red ball"], Rules())
    assert (sharp >= usual).all() and (sharp > usual + 1e-3).any()
