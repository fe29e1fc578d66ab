"""The documentation and the command list what components declare."""

from pathlib import Path

import pytest

from flows.cli.app import main
from flows.config import Settings
from slgaussian.components.registry import list_components

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "components.md"


def test_components_page_is_up_to_date():
    text = list_components()
    assert PAGE.read_text("utf-8").endswith(f"\n\n{text}") and "``" not in text


@pytest.mark.parametrize(
    ("values", "fits"),
    [
        ({"planesweep": {"depth_candidates": 64}, "size": "64x64"}, True),
        ({"planesweep": {"depth_candidates": 4}}, False),
        ({"clip": {"crops": "square"}}, False),
    ],
)
def test_json_schema_accepts_valid_and_refuses_invalid_configurations(values, fits):
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(Settings.model_json_schema())
    assert validator.is_valid(values) == fits


def test_doctor_refuses_components_with_schema(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["slgaussian", "doctor", "--components", "--schema"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2 and "choose one" in capsys.readouterr().err
