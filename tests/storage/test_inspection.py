"""Inspection of files, including damaged and foreign ones and those without a spec."""

import io
import json
import re
import runpy
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from contents import failures, labels

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.language.bank import MemoryBank
from slgaussian.scene import Camera
from slgaussian.semantic.branch import Architecture, make_branch, save_branch
from slgaussian.storage import inspection
from slgaussian.storage.encoding import encode_arrays, encode_table
from slgaussian.storage.provenance import Provenance, record_provenance
from slgaussian.storage.records import Records
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore
from tests.rasterize.hard_cases import splats

ROOT = Path(__file__).parents[2]


def inspect(place) -> list[dict]:
    return list(inspection.inspect(place))


@pytest.fixture
def artifact(tmp_path) -> Path:
    with record_provenance(Provenance("masks", 5, {"replicas": 3}, {"sample": "sample"})):
        ref = ArtifactStore(tmp_path / "store").put("labels", labels(3))
    return tmp_path / "store" / ref.uri


@pytest.fixture
def gaussians() -> Gaussians:
    return replace(splats([[1, 1, 1]] * 6, 1, 1), features=torch.ones(6, 4))


@pytest.fixture
def field(tmp_path, gaussians) -> Path:
    codes = np.float32([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7]])
    features = np.ones((2, 1, 4), np.float32) / 2
    bank = MemoryBank(np.int32([3, 7]), codes, features, np.ones((2, 1), bool))
    camera = Camera(np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]]), np.eye(4), 16, 16)
    settings = {"encoder": "lexicon", "codes": "grid"}
    SemanticField(gaussians, bank, {"a": camera}, settings).save(tmp_path / "f")
    return tmp_path / "f"


def test_inspect_reports_artifact_under_the_name_of_another(artifact):
    other = artifact.with_name("0" * 64 + ".npz")
    shutil.copy(artifact, other)
    assert "expected that of its name" in inspect(other)[0]["problem"]


def test_inspect_lists_every_file_of_a_field(field):
    rows = inspect(field)
    names = ["bank.npz", "field.json", "gaussians.npz", "objects.parquet"]
    assert [Path(row["path"]).name for row in rows] == names
    assert not any(row["problem"] for row in rows)
    assert rows[2]["made"]["stage"] == "build_field"


def test_inspect_reports_damaged_artifacts_of_a_store(store):
    intact, harmed, gone, other = (store.put("labels", labels(value)).uri for value in range(4))
    data = store.read(harmed)
    store.write(harmed, data[:90] + b"?" + data[91:])
    store.write(gone, b"PK")
    store.write(other, foreign()["a.npz"])
    store.write("keys/notes.json", b"{}")
    faults = {
        row["path"].removeprefix(f"{store.root}/"): row["problem"] for row in inspect(store.root)
    }
    assert not faults.pop(intact) and faults.keys() == {harmed, gone, other}
    assert all(
        problem.startswith(store.root) and "\n" not in problem for problem in faults.values()
    )
    with pytest.raises(InputError, match=r"nothing: (found no file|cannot be read)"):
        inspect(f"{store.root}/nothing")


def test_summarize_counts_files_by_stage_and_returns_damaged_rows(store):
    for value in range(4):
        with record_provenance(Provenance("masks", 4 + value // 3, {}, {})):
            ref = store.put("labels", labels(value))
            Records(store).keep(f"masks/v4/{value:064d}", ref)
    store.write(ref.uri, b"PK")
    table, bad = inspection.summarize(inspection.inspect(store.root))
    assert [line.split() for line in table] == [
        ["stage", "spec", "files"],
        ["masks", "v4", "slgaussian/labels@1", "3"],
    ]
    assert [row["path"] for row in bad] == [f"{store.root}/{ref.uri}"]
    assert inspection.is_store(store.root)


def test_inspect_recognises_weights_and_their_damage(tmp_path):
    data = save_branch(make_branch(Architecture(widths=(4, 6), hidden=8), 0))
    (tmp_path / "branch.safetensors").write_bytes(data)
    (row,) = inspect(tmp_path / "branch.safetensors")
    assert not row["problem"] and row["made"]
    (tmp_path / "branch.safetensors").write_bytes(data[:-5])
    assert "is damaged" in inspect(tmp_path / "branch.safetensors")[0]["problem"]


@pytest.mark.parametrize("share", [0.3, 0.9])
@pytest.mark.parametrize("kind", ["npz", "parquet", "json"])
def test_damage_is_one_sentence(tmp_path, kind, share):
    data = {
        "npz": encode_arrays(labels(), load_spec("labels")),
        "parquet": encode_table(failures("a"), load_spec("failures")),
        "json": json.dumps({"spec": "slgaussian/manifest@1", "seed": 0}).encode(),
    }[kind]
    file = tmp_path / f"a.{kind}"
    file.write_bytes(data[: int(len(data) * share)])
    (row,) = inspect(file)
    assert row["problem"].startswith(f"{file}: ") and "\n" not in row["problem"]


def foreign() -> dict[str, bytes]:
    table, arrays = io.BytesIO(), io.BytesIO()
    pq.write_table(pa.table({"a": [1]}), table)
    np.savez(arrays, a=np.zeros(3))
    return {
        "a.parquet": table.getvalue(),
        "a.npz": arrays.getvalue(),
        "a.json": b'{"a": 1}',
        "a.png": b"\x89PNG and so on",
    }


@pytest.mark.parametrize("name", foreign())
def test_inspect_refuses_foreign_files_in_one_sentence(tmp_path, name):
    (tmp_path / name).write_bytes(foreign()[name])
    with pytest.raises(InputError, match=rf"^{tmp_path / name}: [^\n]*$"):
        inspect(tmp_path / name)
    with pytest.raises(InputError, match="found no file there that slgaussian wrote"):
        inspect(tmp_path)
    with pytest.raises(InputError, match=r"nowhere: cannot be read \(No such file"):
        inspect(tmp_path / "nowhere")


SPEC = load_spec("labels")


@pytest.mark.parametrize(
    ("margin", "spec", "problem"),
    [
        (7, SPEC, "margin: found 7, expected values of at most 1"),
        (0, replace(SPEC, version=9), "found slgaussian/labels@9, expected slgaussian/labels@1"),
        (0, replace(SPEC, name="cakes"), "spec: found 'slgaussian/cakes@1', expected one"),
    ],
)
def test_inspect_reports_file_that_breaks_its_spec(tmp_path, margin, spec, problem):
    arrays = {**labels(), "margin": np.full((2, 4, 5), margin, np.float32)}
    (tmp_path / "l.npz").write_bytes(encode_arrays(arrays, spec))
    assert problem in inspect(tmp_path)[0]["problem"]


def test_examples_of_the_guide_need_only_pyarrow_and_numpy(field, tmp_path, monkeypatch, capsys):
    """The examples of the guide, on a real field."""
    guide = (ROOT / "docs/guides/storage.md").read_text("utf-8")
    examples = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    assert examples
    (tmp_path / "results/fields").mkdir(parents=True)
    field.rename(tmp_path / "results/fields/kitchen")
    monkeypatch.chdir(tmp_path)
    for example in examples:
        assert not re.search(r"import (?!json|numpy|pyarrow)", example)
        exec(compile(example, "guide", "exec"), {})
    printed = capsys.readouterr().out
    assert "slgaussian/objects@1 {'codes': 'grid', 'encoder': 'lexicon'}" in printed
    assert "means (6, 3) ['N', 3] scene unit Centres, scene units." in printed


def test_page_of_stored_files_equals_output_of_its_script():
    maker = runpy.run_path(str(ROOT / "docs/make_files.py"))
    assert (ROOT / "docs/reference/files.md").read_text("utf-8") == maker["markdown"]()
