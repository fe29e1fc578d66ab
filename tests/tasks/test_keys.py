import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactRef
from tasks.stage import cache_key, canonical, stage
from tests.plain_stages import call

A = ArtifactRef("labels", "labels/aa/aa.npz", "aa")
B = ArtifactRef("labels", "labels/bb/bb.npz", "bb")

scalars = st.none() | st.booleans() | st.integers() | st.text() | st.floats(allow_nan=False)
scalars = scalars.filter(lambda v: not isinstance(v, float) or abs(v) != float("inf"))
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


def key(settings=None, inputs=None, stage="masks", version=1):
    return cache_key(stage, version, {"settings": settings or {}, "inputs": inputs or {}})


def test_the_form_of_a_key():
    stage, version, digest = key({"replicas": 5}).split("/")
    assert (stage, version) == ("masks", "v1")
    assert len(digest) == 64


@given(st.dictionaries(st.text(), values))
def test_the_order_of_settings_does_not_matter(settings):
    turned = dict(reversed(settings.items()))
    assert key(settings) == key(turned)
    # Files say the canonical form as it stands.
    assert json.dumps(canonical(settings)) == json.dumps(canonical(turned))


@given(values, values)
def test_different_values_have_different_keys(a, b):
    same = json.dumps(canonical(a)) == json.dumps(canonical(b))
    assert (key({"v": a}) == key({"v": b})) == same


def test_numbers_of_different_type_are_different():
    assert len({key({"x": 1}), key({"x": 1.0}), key({"x": True}), key({"x": "1"})}) == 4


def test_all_that_decides_a_result_is_in_the_key():
    keys = [
        key(inputs={"labels": A}),
        key(inputs={"labels": B}),
        key(inputs={"labels": ArtifactRef("sample", "sample/aa/aa.npz", "aa")}),
        key(inputs={"other": A}),
        key({"labels": "aa"}),
        key(version=2),
        key(stage="field"),
        key(),
    ]
    assert len(set(keys)) == len(keys)


def test_where_an_artifact_lies_and_its_meta_are_not():
    moved = ArtifactRef("labels", "somewhere/else.npz", "aa", {"seconds": 3.0})
    assert key(inputs={"labels": moved}) == key(inputs={"labels": A})


@pytest.mark.parametrize(
    "value",
    [
        np.zeros(3),
        np.float32(1),
        Path("photo.png"),
        {1, 2},
        (i for i in range(3)),
        float("nan"),
        {1: "number as key"},
        [1, [2, {"deep": {3}}]],
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_has_no_canonical_form_is_refused_by_name(value):
    with pytest.raises(InputError, match=r"settings\.thing.* cannot be part of a cache key"):
        key({"thing": value})


def test_a_stage_of_another_version_works_anew(tmp_path):
    versions = []

    def of_version(version):
        def work(run, number):
            versions.append(version)
            return run.store.put("packed", {"torch": np.full(3, number, np.uint8)})

        return stage("packed", version)(work)

    for version in (1, 1, 2, 2, 1):
        call(of_version(version), tmp_path, number=4)
    assert versions == [1, 2]
