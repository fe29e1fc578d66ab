"""Configs of components: complete, identified by the content of files, checked, picklable."""

import json
import pickle
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from slgaussian.components.config import ComponentConfig, File
from slgaussian.components.method import Method
from slgaussian.components.registry import KINDS, configure, find_config, list_names, restore
from slgaussian.errors import InputError
from slgaussian.io import file_digest
from slgaussian.language.configs import LexiconConfig
from slgaussian.semantic.branch import Architecture, BranchLifting, make_branch, save_branch
from slgaussian.semantic.configs import BranchConfig

NAMES = {kind: known.default for kind, known in KINDS.items()}
BUILT_IN = [(kind, name) for kind in KINDS for name in list_names(kind)]


@pytest.fixture
def weights(tmp_path) -> Path:
    """Weights of the lifting ``branch``, drawn at random."""
    file = tmp_path / "branch.safetensors"
    file.write_bytes(save_branch(make_branch(Architecture(widths=(4, 8), hidden=8))))
    return file


@pytest.fixture
def branch(weights) -> ComponentConfig:
    """The config of the lifting with these weights, pinned."""
    return find_config("lifting", "branch")(weights=weights).pin()


def test_identity_of_method_is_flat_plain_and_complete():
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
    for method in (
        Method(settings={"lexicon": {"classifier": "none"}}),
        Method("planesweep", encoder=LexiconConfig(classifier="none")),
    ):
        assert json.dumps(method.identity()) == json.dumps(expected)


@pytest.mark.parametrize(("kind", "name"), BUILT_IN)
def test_config_knows_its_kind_and_name_and_survives_pickle(kind, name):
    config = find_config(kind, name)()
    assert (config.kind, config.name) == (kind, name)
    restored = pickle.loads(pickle.dumps(config))
    assert restored == config and type(restored) is type(config)


def test_identity_depends_on_content_of_file_and_not_on_its_place(branch, weights, tmp_path):
    moved = tmp_path / "elsewhere.safetensors"
    moved.write_bytes(weights.read_bytes())
    other = configure("lifting", BranchConfig(weights=moved))
    assert branch.identity() == other.identity() == {"weights": file_digest(weights)}
    assert branch.places() == {"weights": str(weights)} != other.places()
    assert str(tmp_path) not in json.dumps(branch.identity())


def test_restore_loads_component_from_identity_and_places(branch):
    identity = {"lifting": "branch", "branch": branch.identity()}
    restored = restore("lifting", json.loads(json.dumps(identity)), branch.places())
    assert restored == branch == pickle.loads(pickle.dumps(branch))
    assert isinstance(restored.load(), BranchLifting)
    place_alone = restore("lifting", {"lifting": "branch"}, branch.places())  # of any content
    assert isinstance(place_alone.load(), BranchLifting)
    with pytest.raises(InputError, match="no version is in use"):
        restore("lifting", identity).load()


def test_load_refuses_file_that_changed_after_pin(branch, weights):
    weights.write_bytes(b"another")
    with pytest.raises(InputError, match=r"branch\.safetensors: was changed after the run"):
        branch.load()
    with pytest.raises(InputError, match=r"branch\.safetensors: is another$"):
        branch.load("is another")
    weights.unlink()
    with pytest.raises(InputError, match=r"branch\.safetensors: cannot be read \(No such file"):
        branch.load()


def test_pin_reports_missing_file_by_component(tmp_path):
    with pytest.raises(InputError, match=r"weights .*none\.npz: cannot be read"):
        Method(lifting="branch", settings={"branch": {"weights": tmp_path / "none.npz"}})


@pytest.mark.parametrize(
    ("kind", "name", "values", "sentence"),
    [
        ("encoder", "lexcion", {}, "unknown encoder 'lexcion': expected one of .*did you mean"),
        ("encoder", "clip", {"modl": "a"}, "unknown key 'clip.modl'; did you mean 'model'"),
        ("lifting", "hard", {"x": 1}, "unknown key 'hard.x'; the keys are none"),
    ],
)
def test_unknown_component_or_field_is_refused_in_one_sentence(kind, name, values, sentence):
    with pytest.raises(InputError, match=sentence):
        Method(**{kind: name}, settings={name: values})


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
def test_invalid_value_is_refused_in_one_sentence(values, sentence):
    with pytest.raises(InputError) as error:
        Mixed(**values)
    assert str(error.value) == sentence
