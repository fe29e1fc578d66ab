"""What is told of a file, and of files that are damaged, mute or somebody else's."""

import io
import json
import re
import runpy
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from contents import failures, labels

from slgaussian.errors import InputError, SpecError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.language.bank import MemoryBank
from slgaussian.scene import Camera
from slgaussian.semantic.branch import Architecture, Branch, save_branch
from slgaussian.storage.inspection import inspect
from slgaussian.storage.provenance import Made, making
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore, encode_arrays, encode_table

ROOT = Path(__file__).parents[2]


@pytest.fixture
def artifact(tmp_path) -> Path:
    with making(Made("masks", 5, {"replicas": 3}, {"sample": "sample"})):
        ref = ArtifactStore(tmp_path / "store").put("labels", labels(3))
    return tmp_path / "store" / ref.uri


@pytest.fixture
def field(tmp_path) -> Path:
    n = 6
    rows = np.ones((n, 3), np.float32)
    own = {
        "means": rows,
        "scales": rows,
        "quats": np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        "opacities": np.ones(n, np.float32),
        "sh": np.zeros((n, 1, 3), np.float32),
        "source": np.arange(n, dtype=np.int32),
        "features": np.ones((n, 4), np.float32),
    }
    codes = np.float32([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7]])
    features = np.ones((2, 1, 4), np.float32) / 2
    bank = MemoryBank(np.int32([3, 7]), codes, features, np.ones((2, 1), bool))
    camera = Camera(np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]]), np.eye(4), 16, 16)
    settings = {"encoder": "lexicon", "codes": "grid"}
    SemanticField(Gaussians.from_arrays(own), bank, {"a": camera}, settings).save(tmp_path / "f")
    return tmp_path / "f"


def test_an_artifact_is_told_from_its_file_alone(artifact):
    found = inspect(artifact)
    assert found.sound and found.stated and found.form == "NPZ"
    assert found.spec == "slgaussian/labels@1" and found.digest == artifact.stem
    assert (found.made["stage"], found.made["settings"]) == ("masks", {"replicas": 3})
    own = {seen.name: seen for seen in found.fields}
    assert (own["labels"].low, own["labels"].high, own["labels"].unit) == (3, 3, "id")
    assert own["margin"].shape == labels()["margin"].shape
    assert found.bytes == artifact.stat().st_size
    assert json.loads(found.as_json())["fields"][0]["name"] == "labels"


def test_a_table_is_told_with_ranges_and_empty_cells(tmp_path):
    spec = load_spec("judgements")
    rows = [
        {"sample": "a", "clip": "c", "labels": "as found", "lifting": "hard", "iou": iou}
        for iou in (0.25, None, 0.75)
    ]
    table = pa.Table.from_pylist(rows, schema=spec.schema)
    (tmp_path / "judgements.parquet").write_bytes(encode_table(table, spec))
    found = inspect(tmp_path / "judgements.parquet")
    assert found.rows == 3 and found.sound
    iou = next(seen for seen in found.fields if seen.name == "iou")
    assert (iou.low, iou.high, iou.empty) == (0.25, 0.75, 1)


def test_a_file_that_is_not_what_its_spec_says_is_told_with_the_problem(tmp_path):
    wrong = {**labels(), "margin": np.full((2, 4, 5), 7, np.float32)}
    (tmp_path / "l.npz").write_bytes(encode_arrays(wrong, load_spec("labels")))
    found = inspect(tmp_path / "l.npz")
    assert not found.sound and "margin: found 7, expected values of at most 1" in found.problem


def test_a_file_in_the_place_of_another_is_told(artifact):
    other = artifact.with_name("0" * 64 + ".npz")
    shutil.copy(artifact, other)
    assert "expected that of its name" in inspect(other).problem


def test_mute_files_are_known_by_their_place_or_name(artifact, tmp_path):
    np.savez(artifact, **labels(3))
    found = inspect(artifact)
    assert found.sound and not found.stated and not found.made
    assert found.spec == "slgaussian/labels@1"
    pq.write_table(failures("a").replace_schema_metadata(None), tmp_path / "failures.parquet")
    assert not inspect(tmp_path / "failures.parquet").stated


def test_a_field_is_told_with_its_parts(field):
    found = inspect(field)
    assert found.sound and found.form == "field"
    assert [Path(one.path).name for one in found.holds] == [
        "field.json",
        "gaussians.npz",
        "bank.npz",
        "objects.parquet",
    ]
    assert found.holds[1].made["stage"] == "build_field"
    bank = dict(np.load(field / "bank.npz"))
    bank.pop("about.json")
    bank["codes"] = bank["codes"] * np.float32(0.5)
    (field / "bank.npz").write_bytes(encode_arrays(bank, load_spec("bank")))
    assert re.search(
        r"bank.npz: digest: found \w{12}, expected \w{12} as field", inspect(field).problem
    )
    (field / "bank.npz").unlink()
    assert "bank.npz: digest: found no such file" in inspect(field).problem


def test_weights_are_told_by_their_tensors(tmp_path):
    data = save_branch(Branch(Architecture(widths=(4, 6), hidden=8), 0))
    (tmp_path / "branch.safetensors").write_bytes(data)
    found = inspect(tmp_path / "branch.safetensors")
    assert found.sound and found.fields and found.made["settings"]
    (tmp_path / "branch.safetensors").write_bytes(data[:-5])
    with pytest.raises(SpecError, match="is damaged"):
        inspect(tmp_path / "branch.safetensors")


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
    with pytest.raises(SpecError, match=rf"^{file}: is damaged \(.*\); fetch or make it again$"):
        inspect(file)


def foreign() -> dict[str, bytes]:
    table, archive, arrays = io.BytesIO(), io.BytesIO(), io.BytesIO()
    pq.write_table(pa.table({"a": [1]}), table)
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("readme.txt", "hello")
    np.savez(arrays, a=np.zeros(3))
    return {
        "a.parquet": table.getvalue(),
        "a.npz": arrays.getvalue(),
        "b.npz": archive.getvalue(),
        "a.json": b'{"a": 1}',
        "a.png": b"\x89PNG and so on",
        "empty": b"",
    }


@pytest.mark.parametrize("name", foreign())
def test_what_others_wrote_is_refused_in_one_sentence(tmp_path, name):
    (tmp_path / name).write_bytes(foreign()[name])
    with pytest.raises(InputError, match=rf"^{tmp_path / name}: [^\n]*slgaussian [^\n]*$"):
        inspect(tmp_path / name)


def test_a_spec_that_nobody_knows_and_a_later_version_are_told(tmp_path):
    spec = replace(load_spec("labels"), version=9)
    (tmp_path / "l.npz").write_bytes(encode_arrays(labels(), spec))
    assert "slgaussian/labels@1 at most" in inspect(tmp_path / "l.npz").problem
    spec = replace(spec, name="cakes")
    (tmp_path / "l.npz").write_bytes(encode_arrays(labels(), spec))
    with pytest.raises(SpecError, match="spec: found 'slgaussian/cakes@9', expected one of a"):
        inspect(tmp_path / "l.npz")


def test_nothing_and_any_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere: cannot be read \(No such file"):
        inspect(tmp_path / "nowhere")
    with pytest.raises(InputError, match="expected the folder of a field or of a run's results"):
        inspect(tmp_path)


def test_the_index_that_a_run_was_given_may_be_anybodys(tmp_path):
    table = pa.Table.from_pylist([], schema=load_spec("failures").schema)
    (tmp_path / "failures.parquet").write_bytes(encode_table(table, load_spec("failures")))
    (tmp_path / "pairs.json").write_text('{"hall": {"context": ["a", "b"], "target": ["c"]}}')
    found = inspect(tmp_path)
    assert found.sound
    assert [Path(one.path).name for one in found.holds] == ["failures.parquet", "pairs.json"]
    (tmp_path / "other.json").write_text("{}")
    assert not inspect(tmp_path).sound


def test_an_auditor_needs_pyarrow_and_numpy_alone(field, tmp_path, monkeypatch, capsys):
    """The examples of the guide, on a real field."""
    guide = (ROOT / "docs/guides/storage.md").read_text("utf-8")
    examples = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    assert len(examples) == 2
    (tmp_path / "results/fields").mkdir(parents=True)
    field.rename(tmp_path / "results/fields/kitchen")
    monkeypatch.chdir(tmp_path)
    for example in examples:
        assert not re.search(r"import (?!json|numpy|pyarrow)", example)
        exec(compile(example, "guide", "exec"), {})
    told = capsys.readouterr().out
    assert "slgaussian/objects@1 - The objects of a field, one row each." in told
    assert "slgaussian/gaussians@1 build_field {'codes': 'grid', 'encoder': 'lexicon'}" in told
    assert "means (6, 3) ['N', 3] scene unit Centres, scene units." in told
    assert "'numpy': " in told


def test_the_page_of_stored_files_is_what_its_maker_writes():
    made = runpy.run_path(str(ROOT / "docs/make_files.py"))
    assert (ROOT / "docs/reference/files.md").read_text("utf-8") == made["markdown"]()
