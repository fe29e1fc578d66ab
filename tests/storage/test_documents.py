import pytest

from slgaussian.errors import SpecError
from slgaussian.storage.specs import Entry, Spec, load_spec, spec_names
from tests.json_documents import TYPES, check_document

SPEC = Spec(
    "own",
    "Own.",
    keys={
        "name": Entry("text", "A name."),
        "count": Entry("integer", "How many.", unit="count", low=0, nullable=True),
        "kind": Entry("text", "A kind.", optional=True, values=("a", "b")),
        "parts": Entry("object", "Parts."),
        "parts.*": Entry("list", "Sizes."),
        "parts.*[]": Entry("number", "A size.", unit="pixel"),
        "free": Entry("object", "Anything.", optional=True),
    },
)
GOOD = {"name": "x", "count": 3, "parts": {"p": [1, 2.5]}, "free": {"any": ["thing"]}}


def test_what_fits_passes():
    check_document(GOOD, SPEC, "f")
    check_document({**GOOD, "count": None, "kind": "b", "parts": {}}, SPEC, "f")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": 3}, "f: name: 3 is not of type 'string'"),
        ({"count": True}, "f: count: True is not of type 'integer'"),
        ({"count": -1}, "f: count: -1 is less than the minimum of 0"),
        ({"count": 1.5}, "f: count: 1.5 is not of type 'integer'"),
        ({"kind": "c"}, "f: kind: 'c' is not one of ['a', 'b'"),
        ({"kind": None}, "f: kind: None is not of type 'string'"),
        ({"parts": {"p": [1, "2"]}}, "f: parts.p[1]: '2' is not of type 'number'"),
        ({"parts": {"p": 1}}, "f: parts.p: 1 is not of type 'array'"),
        ({"more": 1}, "f: file: Additional properties are not allowed ('more' was unexpected)"),
    ],
)
def test_what_does_not_is_named(changed, message):
    with pytest.raises(SpecError) as error:
        check_document({**GOOD, **changed}, SPEC, "f")
    assert message in str(error.value)


def test_what_is_missing_is_named():
    with pytest.raises(SpecError, match="f: file: 'parts' is a required property"):
        check_document({"name": "x", "count": 1}, SPEC, "f")


@pytest.mark.parametrize("name", [name for name in spec_names() if load_spec(name).keys])
def test_keys_of_documents_are_complete(name):
    spec = load_spec(name)
    for place, key in spec.keys.items():
        assert key.type in TYPES and key.doc
        above = place.rpartition(".")[0] if not place.endswith("[]") else place[:-2]
        assert not above or above in spec.keys, f"{place} stands below nothing"
