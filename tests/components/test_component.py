"""Components with their settings: complete, identified by the content of files, checked."""

import json
import pickle
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from slgaussian.components.component import Component
from slgaussian.components.config import ComponentConfig, File
from slgaussian.components.method import Method
from slgaussian.components.registry import KINDS
from slgaussian.errors import InputError
from slgaussian.io import KnownFile, file_digest
from slgaussian.semantic.branch import Architecture, BranchLifting, make_branch, save_branch

NAMES = {kind: known.default for kind, known in KINDS.items()}


@pytest.fixture
def weights(tmp_path) -> Path:
    """Weights of the lifting ``branch``, drawn at random."""
    file = tmp_path / "branch.safetensors"
    file.write_bytes(save_branch(make_branch(Architecture(widths=(4, 8), hidden=8))))
    return file


def test_the_identity_is_flat_plain_and_complete():
    expected = {
        **NAMES,
        "replicas": 5,
        "votes": "views",
        "seed": 0,
        "keep": "needed",
        "bank": "groups",
        "planesweep": {"depth_candidates": 144},
        "lexicon": {"classifier": "none"},
    }
    method = Method(settings={"lexicon": {"classifier": "none"}})
    assert json.dumps(method.identity()) == json.dumps(expected)


def test_a_file_is_known_by_its_content_wherever_it_is(weights, tmp_path):
    moved = tmp_path / "elsewhere.safetensors"
    moved.write_bytes(weights.read_bytes())
    places = weights, moved
    first, second = (Component.of("lifting", "branch", {"weights": place}) for place in places)
    assert first.identity() == second.identity() == {"weights": file_digest(weights)}
    assert first.places() == {"weights": str(weights)} != second.places()
    assert str(tmp_path) not in json.dumps(first.identity())


def test_a_part_comes_back_from_its_identity_and_its_places(weights):
    component = Component.of("lifting", "branch", {"weights": str(weights)})
    identity = {"lifting": "branch", "branch": component.identity()}
    restored = Component.stored("lifting", json.loads(json.dumps(identity)), component.places())
    assert restored == component == pickle.loads(pickle.dumps(component))
    assert isinstance(restored.load(), BranchLifting)
    with pytest.raises(InputError, match="no version is in use"):
        Component.stored("lifting", identity).load()


def test_a_file_that_changed_is_refused(weights):
    part = Component.of("lifting", "branch", {"weights": weights})
    weights.write_bytes(b"another")
    with pytest.raises(InputError, match=r"branch\.safetensors: was changed after the run"):
        part.load()
    with pytest.raises(InputError, match=r"branch\.safetensors: is another$"):
        part.load("is another")
    weights.unlink()
    with pytest.raises(InputError, match=r"branch\.safetensors: cannot be read \(No such file"):
        part.load()


def test_a_file_of_which_no_digest_is_known_may_be_any(weights):
    assert KnownFile(str(weights), None).checked("weights", file_digest) == str(weights)


def test_a_missing_file_is_said_by_the_part_that_needs_it(tmp_path):
    with pytest.raises(InputError, match=r"weights .*none\.npz: cannot be read"):
        Component.of("lifting", "branch", {"weights": tmp_path / "none.npz"})


@pytest.mark.parametrize(
    ("kind", "name", "values", "sentence"),
    [
        ("encoder", "lexcion", {}, "unknown encoder 'lexcion': expected one of .*did you mean"),
        ("encoder", "clip", {"modl": "a"}, "unknown key 'clip.modl'; did you mean 'model'"),
        ("lifting", "hard", {"x": 1}, "unknown key 'hard.x'; the keys are none"),
    ],
)
def test_what_is_unknown_is_one_sentence(kind, name, values, sentence):
    with pytest.raises(InputError, match=sentence):
        Component.of(kind, name, values)


class Mixed(ComponentConfig):
    """Fields of every sort."""

    count: int = Field(3, ge=1, le=5)
    share: float | None = Field(None, ge=0, le=1)
    many: Annotated[int, Field(ge=1)] | Literal["auto"] = 2
    sort: Literal["a", "bee"] = "a"
    place: Annotated[str | Path | None, File(file_digest)] = None


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"count": 0}, "mixed count: found 0, expected a whole number from 1 to 5"),
        ({"share": float("nan")}, "mixed share: found nan, expected a number from 0 to 1"),
        ({"many": 0}, "mixed many: found 0, expected a whole number from 1 or 'auto'"),
        ({"sort": "be"}, "mixed sort: found 'be', expected one of a, bee; did you mean 'bee'?"),
        ({"sort": "c", "cuont": 1}, "unknown key 'mixed.cuont'; did you mean 'count'?"),
    ],
)
def test_a_value_that_does_not_fit_is_one_sentence(values, sentence):
    with pytest.raises(InputError) as error:
        Mixed(**values)
    assert str(error.value) == sentence
