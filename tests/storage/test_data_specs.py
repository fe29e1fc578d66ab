import re
import tomllib
from contextlib import nullcontext
from importlib import resources

import numpy as np
import pyarrow as pa
import pytest
from contents import failures

from slgaussian.benchmark import attribution
from slgaussian.errors import SpecError
from slgaussian.storage.specs import UNITS, arrow_type, load_spec, parse_label, spec_names
from tests.json_documents import TYPES

SPECS = resources.files("data_specs")


@pytest.mark.parametrize("name", spec_names())
def test_every_spec_is_complete(name):
    spec = load_spec(name)
    assert spec.doc
    assert "version" in tomllib.loads((SPECS / f"{name}.toml").read_text("utf-8"))
    assert parse_label(spec.label) == (name, spec.version)
    assert sum(map(bool, (spec.fields, spec.columns, spec.keys, spec.open))) == 1
    for field in spec.fields.values():
        assert field.type == "str" or np.dtype(field.type).name == field.type
        assert bool(field.unit) == (field.type not in ("str", "bool"))
    for column in spec.columns.values():
        assert arrow_type(column.type)
        assert bool(column.unit) == (column.type.split()[0] not in ("string", "bool", "binary"))
    for entry in (*spec.fields.values(), *spec.columns.values()):
        assert entry.doc
        assert entry.unit in ("", *UNITS)
    letters = {axis for array in spec.fields.values() for axis in array.shape if axis == str(axis)}
    assert set(spec.axes) == letters


def test_attribution_spec_lists_all_causes_of_a_miss():
    causes = {*attribution.STAGES, attribution.UNFIXABLE}
    assert set(load_spec("attribution").columns["lost"].values) == causes


def test_load_spec_lists_specs_for_an_unknown_name():
    with pytest.raises(SpecError, match=r"no data spec 'lables': expected one of .*labels"):
        load_spec("lables")


def gaussians(n: int = 3) -> dict[str, np.ndarray]:
    return {
        "means": np.zeros((n, 3), np.float32),
        "scales": np.ones((n, 3), np.float32),
        "quats": np.ones((n, 4), np.float32),
        "opacities": np.ones(n, np.float32),
        "sh": np.zeros((n, 1, 3), np.float32),
        "source": np.zeros(n, np.int32),
    }


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("features", np.zeros((3, 7), np.float32), ""),
        ("means", None, "f.npz: means: found no such field, expected float32 [N, 3]"),
        ("extra", np.zeros(3), "f.npz: extra: found an unknown field, expected only means, scales"),
        ("means", np.zeros((3, 3)), "f.npz: means: found float64 [3, 3], expected float32 [N, 3]"),
        ("quats", np.ones((3, 3), np.float32), "found float32 [3, 3], expected float32 [N, 4]"),
        ("sh", np.zeros((3, 3), np.float32), "found float32 [3, 3], expected float32 [N, K, 3]"),
        ("scales", np.ones((4, 3), np.float32), "expected float32 [N, 3] with N = 3 as in means"),
        ("means", np.full((3, 3), np.nan, np.float32), "means: found NaN or infinity"),
        ("opacities", np.full(3, 1.5, np.float32), "found 1.5, expected values of at most 1"),
        ("source", np.full(3, -2, np.int32), "source: found -2, expected values of at least -1"),
    ],
)
def test_check_arrays_error_has_file_field_actual_and_expected(name, value, message):
    arrays = gaussians() | {name: value}
    if value is None:
        del arrays[name]
    with expect_refusal(message) if message else nullcontext():
        load_spec("gaussians").check_arrays(arrays, "f.npz")


def expect_refusal(message: str):
    return pytest.raises(SpecError, match=re.escape(message))


def test_check_table_refuses_each_invalid_column():
    spec, good = load_spec("failures"), failures("a")
    spec.check_table(good, "t")
    for wrong, message in (
        (good.drop_columns("reason"), "t: reason: found no such column"),
        (good.set_column(1, "stage", pa.array([1])), "t: stage: found int64, expected string"),
        (good.set_column(1, "stage", pa.nulls(1, pa.string())), "t: stage: found 1 empty cells"),
        (good.append_column("more", pa.array([1])), "t: more: found an unknown column"),
    ):
        with expect_refusal(message):
            spec.check_table(wrong, "t")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"iou": 1.01}, "t: iou: found 1.01, expected values of at most 1"),
        ({"iou": -0.5}, "t: iou: found -0.5, expected values of at least 0"),
        ({"iou": float("nan")}, "t: iou: found NaN or infinity, expected finite numbers"),
        ({"absent": "keep"}, "t: absent: found 'keep', expected one of ['skip', 'zero']"),
        ({"iou": 1 + 1e-12, "absent": None}, ""),
    ],
)
def test_values_of_tables_have_bounds(changed, message):
    spec = load_spec("samples")
    row = {name: "" if column.type == "string" else 1 for name, column in spec.columns.items()}
    row |= {"selection": "none", "absent": "skip", "hit_mask": True}
    row |= {"hit_box": None, "hit_peak": None}
    table = pa.Table.from_pylist([row | changed], schema=spec.schema)
    spec.check_table(table.slice(0, 0), "t")
    with expect_refusal(message) if message else nullcontext():
        spec.check_table(table, "t")


@pytest.mark.parametrize("context", [[None], [0, None], [None, None, 2]])
def test_check_table_refuses_empty_item_of_a_list_in_any_row(context):
    spec = load_spec("pairs")
    row = {name: "a" if column.type == "string" else 1 for name, column in spec.columns.items()}
    rows = [row | {"context": c, "targets": [3]} for c in ([0, 1], [], context)]
    spec.check_table(pa.Table.from_pylist(rows[:2], schema=spec.schema), "t")
    table = pa.Table.from_pylist(rows, schema=spec.schema)
    with expect_refusal(f"t: context: found {context.count(None)} empty items in its lists"):
        spec.check_table(table, "t")


def test_check_arrays_refuses_masked_values():
    hidden = np.ma.masked_less(gaussians()["means"], np.inf)
    with expect_refusal("f.npz: means: found 9 masked values"):
        load_spec("gaussians").check_arrays(gaussians() | {"means": hidden}, "f.npz")


@pytest.mark.parametrize("name", [name for name in spec_names() if load_spec(name).keys])
def test_keys_of_documents_are_complete(name):
    spec = load_spec(name)
    for place, key in spec.keys.items():
        assert key.type in TYPES and key.doc
        above = place.rpartition(".")[0] if not place.endswith("[]") else place[:-2]
        assert not above or above in spec.keys, f"{place} stands below nothing"
