"""Files describe their content and origin, readable with pyarrow or NumPy alone."""

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from contents import failures, labels

from slgaussian import __version__
from slgaussian.errors import SpecError
from slgaussian.storage.encoding import (
    arrays_digest,
    decode_arrays,
    decode_table,
    encode_arrays,
    encode_table,
    read_metadata,
)
from slgaussian.storage.provenance import (
    Provenance,
    provenance_metadata,
    record_provenance,
    software,
)
from slgaussian.storage.specs import load_spec

MADE = Provenance("masks", 5, {"replicas": 3}, {"sample": "sample"})
SAID = {
    "program": f"slgaussian {__version__}",
    "stage": "masks",
    "stage_version": 5,
    "settings": {"replicas": 3},
    "of": {"sample": "sample"},
    "software": software(),
}


def test_npz_file_contains_spec_and_provenance(local):
    with record_provenance(MADE):
        ref = local.put("labels", labels())
    with np.load(io.BytesIO(local.read(ref.uri))) as file:
        assert set(file.files) == {"about.json", "labels", "margin"}
        metadata = json.loads(file["about.json"])
    assert (metadata["spec"], metadata["made"]) == ("slgaussian/labels@1", SAID)
    assert metadata["meaning"] == load_spec("labels").doc
    assert metadata["axes"].keys() == {"V", "H", "W"}
    margin = metadata["fields"]["margin"]
    assert margin["axes"] == ["V", "H", "W"]
    assert (margin["unit"], margin["low"], margin["high"]) == ("1", 0, 1)
    assert metadata["fields"]["labels"]["meaning"] == load_spec("labels").fields["labels"].doc
    assert read_metadata(local.read(ref.uri)) == metadata


def test_parquet_metadata_contain_spec_and_provenance(local):
    with record_provenance(MADE):
        ref = local.put("failures", failures("a"))
    data = local.read(ref.uri)
    schema = pq.read_schema(io.BytesIO(data))
    metadata = {key.decode(): value.decode() for key, value in schema.metadata.items()}
    assert metadata["spec"] == "slgaussian/failures@1"
    assert metadata["meaning"] == load_spec("failures").doc
    assert json.loads(metadata["made"]) == SAID
    for name, column in load_spec("failures").columns.items():
        assert schema.field(name).metadata[b"meaning"].decode() == column.doc
    assert read_metadata(data)["made"] == SAID
    assert local.get(ref).equals(failures("a"))


def test_digest_does_not_depend_on_provenance(local):
    plain = local.put("labels", labels())
    with record_provenance(MADE):
        ref = local.put("labels", labels())
    assert plain == ref and plain.uri == ref.uri
    assert local.read(ref.uri) != encode_arrays(labels(), load_spec("labels"))


def test_put_keeps_the_same_provenance_in_any_order_of_stages(local):
    works = [MADE, Provenance("masks", 5, {"replicas": 5}), Provenance("other", 1)]
    left = set()
    for order in (works, works[::-1], [works[1], works[2], works[0]]):
        ref = local.put("labels", labels())  # nobody says who
        for origin in order:
            with record_provenance(origin):
                local.put("labels", labels())
        local.put("labels", labels())
        left.add(local.read(ref.uri))
        local.remove([ref.uri])
    assert read_metadata(left.pop())["made"]["stage"] == "masks" and not left


def test_content_passed_through_a_stage_does_not_name_it(local):
    digest = arrays_digest(labels())
    with record_provenance(Provenance("a", 1, passed_through={digest})):
        ref = local.put("labels", labels())
        assert "stage" not in read_metadata(local.read(ref.uri))["made"]
    with record_provenance(Provenance("z", 1)):
        local.put("labels", labels())
    with record_provenance(Provenance("a", 1, passed_through={digest})):
        local.put("labels", labels())
    assert read_metadata(local.read(ref.uri))["made"]["stage"] == "z"


@pytest.mark.parametrize("label", ["slgaussian/bank@1", "slgaussian/labels@99", "else's", "none"])
def test_decode_refuses_files_of_another_spec_or_version(label):
    spec, about = load_spec("labels"), "{}" if label == "none" else json.dumps({"spec": label})
    with pytest.raises(SpecError, match=f"^f: spec: found {label}, expected {spec.label}; mend$"):
        decode_arrays(rewrite(encode_arrays(labels(), spec), about), spec, "f", "mend")
    buffer = io.BytesIO()
    metadata = None if label == "none" else {"spec": label}
    pq.write_table(failures("a").replace_schema_metadata(metadata), buffer)
    with pytest.raises(SpecError, match=f"^f: spec: found {label}, expected"):
        decode_table(buffer.getvalue(), load_spec("failures"), "f", "mend")


def rewrite(data: bytes, about: str) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            new.writestr(name, about if name == "about.json" else old.read(name))
    return out.getvalue()


@pytest.mark.parametrize("about", ["", "[]", '{"spec": 3}', "{"])
def test_decode_refuses_file_with_invalid_metadata(about):
    spec = load_spec("labels")
    data = rewrite(encode_arrays(labels(), spec), about)
    with pytest.raises(SpecError, match=r"f: file: found .* bytes that cannot be read"):
        decode_arrays(data, spec, "f")


def test_encode_table_ignores_metadata_of_the_table():
    spec, table = load_spec("failures"), failures("a", "b")
    named = table.set_column(0, "scene", pa.array(["a", "b"]))
    with record_provenance(MADE):
        assert encode_table(named, spec) == encode_table(table, spec)
        assert json.dumps(provenance_metadata()) == json.dumps(provenance_metadata())


def read_commit(folder: Path) -> str:
    """Return the commit that a program in a folder states."""
    code = "from slgaussian.storage.provenance import commit; print(commit())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(folder)},
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def test_commit_of_clone_or_of_installation_from_repository(tmp_path):
    def git(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        command = ["git", "-C", tmp_path, *identity, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    package = Path(__file__).parents[2] / "slgaussian"
    skip = shutil.ignore_patterns("__pycache__", "*.xz", "*.toml")
    shutil.copytree(package, tmp_path / "slgaussian", ignore=skip)
    assert read_commit(tmp_path) == "unknown"
    (tmp_path / ".gitignore").write_text(".venv\n__pycache__\n")
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "first"]):
        git(*words)
    head = git("rev-parse", "HEAD")
    assert read_commit(tmp_path) == head
    (tmp_path / "slgaussian" / "added.py").write_text("")
    assert read_commit(tmp_path) == f"{head}, changed"

    installed = tmp_path / ".venv"  # in the repository, but not of it
    shutil.copytree(tmp_path / "slgaussian", installed / "slgaussian", ignore=skip)
    (installed / "slgaussian-0.1.0.dist-info").mkdir()
    metadata = "Metadata-Version: 2.1\nName: slgaussian\nVersion: 0.1.0\n"
    (installed / "slgaussian-0.1.0.dist-info/METADATA").write_text(metadata)
    assert read_commit(installed) == "unknown"
    origin = {"url": "https://host/a.git", "vcs_info": {"vcs": "git", "commit_id": "c" * 40}}
    (installed / "slgaussian-0.1.0.dist-info/direct_url.json").write_text(json.dumps(origin))
    assert read_commit(installed) == "c" * 40
