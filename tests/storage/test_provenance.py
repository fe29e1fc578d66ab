"""Files describe their content and origin, readable with pyarrow or NumPy alone."""

import io
import json
import os
import shutil
import subprocess
import sys
import uuid
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
from slgaussian.storage.store import ArtifactStore

MADE = Provenance("masks", 5, {"replicas": 3}, {"sample": "sample"})
SAID = {
    "program": f"slgaussian {__version__}",
    "stage": "masks",
    "stage_version": 5,
    "settings": {"replicas": 3},
    "of": {"sample": "sample"},
    "software": software(),
}


@pytest.fixture
def store() -> ArtifactStore:
    return ArtifactStore(f"memory://{uuid.uuid4().hex}")


def test_arrays_say_what_they_are_and_what_made_them(store):
    with record_provenance(MADE):
        ref = store.put("labels", labels())
    with np.load(io.BytesIO(store.read(ref.uri))) as file:
        assert set(file.files) == {"about.json", "labels", "margin"}
        metadata = json.loads(file["about.json"])
    assert (metadata["spec"], metadata["made"]) == ("slgaussian/labels@1", SAID)
    assert metadata["meaning"] == load_spec("labels").doc
    assert metadata["axes"].keys() == {"V", "H", "W"}
    margin = metadata["fields"]["margin"]
    assert margin["axes"] == ["V", "H", "W"]
    assert (margin["unit"], margin["low"], margin["high"]) == ("1", 0, 1)
    assert metadata["fields"]["labels"]["meaning"] == load_spec("labels").fields["labels"].doc
    assert read_metadata(store.read(ref.uri)) == metadata


def test_tables_say_so_in_arrows_metadata(store):
    with record_provenance(MADE):
        ref = store.put("failures", failures("a"))
    data = store.read(ref.uri)
    schema = pq.read_schema(io.BytesIO(data))
    metadata = {key.decode(): value.decode() for key, value in schema.metadata.items()}
    assert metadata["spec"] == "slgaussian/failures@1"
    assert metadata["meaning"] == load_spec("failures").doc
    assert json.loads(metadata["made"]) == SAID
    for name, column in load_spec("failures").columns.items():
        assert schema.field(name).metadata[b"meaning"].decode() == column.doc
    assert read_metadata(data)["made"] == SAID
    assert store.get(ref).equals(failures("a"))


def test_what_made_a_file_is_no_part_of_its_digest(store):
    plain = store.put("labels", labels())
    with record_provenance(MADE):
        ref = store.put("labels", labels())
    assert plain == ref and plain.uri == ref.uri
    assert store.read(ref.uri) != encode_arrays(labels(), load_spec("labels"))


def test_of_two_works_with_one_result_the_same_is_named_in_any_order(store):
    works = [MADE, Provenance("masks", 5, {"replicas": 5}), Provenance("other", 1)]
    left = set()
    for order in (works, works[::-1], [works[1], works[2], works[0]]):
        ref = store.put("labels", labels())  # nobody says who
        for origin in order:
            with record_provenance(origin):
                store.put("labels", labels())
        store.put("labels", labels())
        left.add(store.read(ref.uri))
        store.remove([ref.uri])
    assert read_metadata(left.pop())["made"]["stage"] == "masks" and not left


def test_what_only_passes_through_was_made_by_others(store):
    digest = arrays_digest(labels())
    with record_provenance(Provenance("a", 1, passed_through={digest})):
        ref = store.put("labels", labels())
        assert "stage" not in read_metadata(store.read(ref.uri))["made"]
    with record_provenance(Provenance("z", 1)):
        store.put("labels", labels())
    with record_provenance(Provenance("a", 1, passed_through={digest})):
        store.put("labels", labels())
    assert read_metadata(store.read(ref.uri))["made"]["stage"] == "z"


@pytest.mark.parametrize("label", ["slgaussian/bank@1", "slgaussian/labels@99", "else's", "none"])
def test_files_of_another_spec_or_version_are_refused(label):
    spec, about = load_spec("labels"), "{}" if label == "none" else json.dumps({"spec": label})
    with pytest.raises(SpecError, match=f"^f: spec: found {label}, expected {spec.label}; mend$"):
        decode_arrays(rewritten(encode_arrays(labels(), spec), about), spec, "f", "mend")
    buffer = io.BytesIO()
    metadata = None if label == "none" else {"spec": label}
    pq.write_table(failures("a").replace_schema_metadata(metadata), buffer)
    with pytest.raises(SpecError, match=f"^f: spec: found {label}, expected"):
        decode_table(buffer.getvalue(), load_spec("failures"), "f", "mend")


def rewritten(data: bytes, about: str) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            new.writestr(name, about if name == "about.json" else old.read(name))
    return out.getvalue()


@pytest.mark.parametrize("about", ["", "[]", '{"spec": 3}', "{"])
def test_a_statement_that_is_none_is_damage(about):
    spec = load_spec("labels")
    data = rewritten(encode_arrays(labels(), spec), about)
    with pytest.raises(SpecError, match=r"f: file: found .* bytes that cannot be read"):
        decode_arrays(data, spec, "f")


def test_the_same_work_leaves_the_same_bytes_whatever_the_tables_own_metadata():
    spec, table = load_spec("failures"), failures("a", "b")
    named = table.set_column(0, "scene", pa.array(["a", "b"]))
    with record_provenance(MADE):
        assert encode_table(named, spec) == encode_table(table, spec)
        assert json.dumps(provenance_metadata()) == json.dumps(provenance_metadata())


def committed(folder: Path) -> str:
    """Return the commit that a program in a folder states."""
    code = "from slgaussian.storage.provenance import commit; print(commit())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(folder)},
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def test_commit_is_that_of_a_clone_or_of_its_installation_else_unknown(tmp_path):
    def git(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        command = ["git", "-C", tmp_path, *identity, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    package = Path(__file__).parents[2] / "slgaussian"
    skip = shutil.ignore_patterns("__pycache__", "*.xz", "*.toml")
    shutil.copytree(package, tmp_path / "slgaussian", ignore=skip)
    assert committed(tmp_path) == "unknown"
    (tmp_path / ".gitignore").write_text(".venv\n__pycache__\n")
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "first"]):
        git(*words)
    head = git("rev-parse", "HEAD")
    assert committed(tmp_path) == head
    (tmp_path / "slgaussian" / "added.py").write_text("")
    assert committed(tmp_path) == f"{head}, changed"

    installed = tmp_path / ".venv"  # in the repository, but not of it
    shutil.copytree(tmp_path / "slgaussian", installed / "slgaussian", ignore=skip)
    (installed / "slgaussian-0.1.0.dist-info").mkdir()
    metadata = "Metadata-Version: 2.1\nName: slgaussian\nVersion: 0.1.0\n"
    (installed / "slgaussian-0.1.0.dist-info/METADATA").write_text(metadata)
    assert committed(installed) == "unknown"
    origin = {"url": "https://host/a.git", "vcs_info": {"vcs": "git", "commit_id": "c" * 40}}
    (installed / "slgaussian-0.1.0.dist-info/direct_url.json").write_text(json.dumps(origin))
    assert committed(installed) == "c" * 40
