"""Parts with their settings: complete, known by the content of their files, and checked."""

import json
import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from slgaussian.errors import InputError
from slgaussian.language.named import Named
from slgaussian.parts.identity import KnownFile, file_digest
from slgaussian.parts.method import Method
from slgaussian.parts.part import Part
from slgaussian.parts.registry import KINDS, find_part, names_of
from slgaussian.parts.settings import check_settings, setting, settings_of

NAMES = {kind: known.default for kind, known in KINDS.items()}


@pytest.fixture
def table(tmp_path) -> Path:
    """A table of names for the encoder ``named``."""
    file = tmp_path / "names.npz"
    np.savez(file, names=np.array(["ball", "box"]), features=np.eye(2, dtype=np.float32))
    return file


def test_the_identity_is_flat_plain_and_complete():
    expected = {
        **NAMES,
        "replicas": 5,
        "seed": 0,
        "keep": "needed",
        "bank": "groups",
        "planesweep": {"depth_candidates": 144},
        "separated": {"dimension": 3, "error": 0.01},
    }
    assert json.dumps(Method().identity()) == json.dumps(expected)


def test_a_file_is_known_by_its_content_wherever_it_is(table, tmp_path):
    moved = tmp_path / "elsewhere.npz"
    moved.write_bytes(table.read_bytes())
    here, there = (Part.of("encoder", "named", {"table": place}) for place in (table, moved))
    assert here.identity() == there.identity() == {"table": file_digest(table)}
    assert here.places() == {"table": str(table)} != there.places()
    assert str(tmp_path) not in json.dumps(here.identity())


def test_a_part_comes_back_from_its_identity_and_its_places(table):
    made = Part.of("encoder", "named", {"table": str(table)})
    identity = {"encoder": "named", "named": made.identity()}
    again = Part.stored("encoder", json.loads(json.dumps(identity)), made.places())
    assert again == made == pickle.loads(pickle.dumps(made))
    assert isinstance(again.load(), Named)
    with pytest.raises(InputError, match=r"table : cannot be read"):
        Part.stored("encoder", identity).load()


def test_a_file_that_changed_is_refused(table):
    part = Part.of("encoder", "named", {"table": table})
    table.write_bytes(b"another")
    with pytest.raises(InputError, match=r"table .*names\.npz: was changed after the run"):
        part.load()
    with pytest.raises(InputError, match=r"names\.npz: is another$"):
        part.load("is another")
    table.unlink()
    with pytest.raises(InputError, match=r"names\.npz: cannot be read \(No such file"):
        part.load()


def test_a_file_of_which_no_digest_is_known_may_be_any(table):
    assert KnownFile(str(table), None).checked("table", file_digest) == str(table)


def test_a_missing_file_is_said_by_the_part_that_needs_it(tmp_path):
    with pytest.raises(InputError, match=r"named table .*none\.npz: cannot be read"):
        Part.of("encoder", "named", {"table": tmp_path / "none.npz"})


@pytest.mark.parametrize(
    ("kind", "name", "values", "sentence"),
    [
        ("encoder", "lexcion", {}, "unknown encoder 'lexcion': expected one of .*did you mean"),
        ("encoder", "clip", {"modl": "a"}, "settings of 'clip': found 'modl'; did you"),
        ("lifting", "hard", {"x": 1}, "settings of 'hard': found 'x', expected some of: none"),
    ],
)
def test_what_is_unknown_is_one_sentence(kind, name, values, sentence):
    with pytest.raises(InputError, match=sentence):
        Part.of(kind, name, values)


@dataclass(frozen=True)
class Own:
    """Settings of every sort."""

    count: int = setting(3, "How many.", low=1, high=5)
    share: float | None = setting(None, "How much.", low=0, high=1, expected="a share")
    many: int | str = setting(2, "At least one.", low=1)
    sort: str = setting("a", "Which.", choices=("a", "bee"))
    inner: int = 7

    def __post_init__(self) -> None:
        check_settings(self, "own")


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"count": 0}, "own count: found 0, expected 1 to 5"),
        ({"count": 2.5}, "own count: found 2.5, expected 1 to 5"),
        ({"count": "two"}, "own count: found 'two', expected 1 to 5"),
        ({"share": float("nan")}, "own share: found nan, expected a share"),
        ({"many": 0}, "own many: found 0, expected at least 1"),
        ({"sort": "be"}, "own sort: found 'be', expected one of a, bee; did you mean 'bee'?"),
    ],
)
def test_values_are_held_against_the_declaration(values, sentence):
    with pytest.raises(InputError) as error:
        Own(**values)
    assert str(error.value) == sentence


def test_what_fits_passes():
    assert Own(count=5, share=0.5, many=9, sort="bee").share == 0.5
    assert list(settings_of(Own)) == ["count", "share", "many", "sort"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_setting_says_what_it_is(kind):
    for name in names_of(kind):
        part = find_part(kind, name)
        assert part.__doc__
        for declared in settings_of(part).values():
            assert declared.help.endswith(".")
            assert declared.fits(declared.default)
