import io
import os
import stat
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from contents import failures, labels
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from slgaussian.errors import InputError, SpecError
from slgaussian.storage.encoding import (
    arrays_digest,
    decode_arrays,
    encode_arrays,
    encode_table,
    table_digest,
)
from slgaussian.storage.specs import Spec, load_spec
from slgaussian.storage.store import ArtifactRef, ArtifactStore


def find_file(store: ArtifactStore, ref: ArtifactRef) -> Path:
    return Path(store.path) / ref.uri


def test_get_returns_equal_arrays_and_tables(store):
    ref = store.put("labels", labels(), {"objects": 1})
    back = store.get(ref)
    assert set(back) == {"labels", "margin"}
    for name, array in labels().items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)
    assert ref.meta == {"objects": 1}
    table = failures("a", "b")
    assert store.get(store.put("failures", table)).equals(table)


def test_put_writes_one_file_for_equal_content(store):
    a, b, c = (store.put("labels", labels(v)) for v in (3, 3, 4))
    assert a == b
    assert a.uri == f"labels/{a.digest[:2]}/{a.digest}.npz"
    assert c.digest != a.digest
    assert len([p for p in store.fs.find(store.path) if p.endswith(".npz")]) == 2


@given(
    npst.arrays(
        dtype=st.sampled_from([np.uint8, np.int32, np.float32, np.float64, np.bool_, "<U3"]),
        shape=npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    )
)
def test_arrays_and_digest_survive_a_round_trip(array):
    arrays = {"a": array, "b": np.arange(3)}
    for compress in (True, False):
        anything = Spec("anything", "Any.", compress=compress, open=True)
        data = encode_arrays(arrays, anything)
        assert data == encode_arrays(dict(reversed(arrays.items())), anything)
        back = decode_arrays(data, anything, "file")
        assert back["a"].dtype == array.dtype
        assert arrays_digest(back) == arrays_digest(arrays)


@pytest.mark.parametrize(
    "other",
    [
        {"a": np.zeros((2, 3), np.float32)},
        {"b": np.zeros((3, 2), np.float32)},
        {"a": np.zeros((3, 2), np.float64)},
        {"a": np.zeros((3, 2), np.int32)},  # the same bytes
        {"a": np.zeros((3, 2), np.float32) - 0.0, "b": np.zeros(1)},
        {"a": np.full((3, 2), -0.0, np.float32)},
    ],
)
def test_digest_depends_on_name_shape_dtype_and_bits(other):
    assert arrays_digest({"a": np.zeros((3, 2), np.float32)}) != arrays_digest(other)


def test_table_digest_ignores_chunks_but_not_values_and_types():
    table = failures("a", "b")
    parts = pa.concat_tables([failures("a"), failures("b")])
    assert table_digest(parts) == table_digest(table)
    spec = load_spec("failures")
    assert encode_table(parts, spec) == encode_table(table, spec)
    assert table_digest(failures("a", "c")) != table_digest(table)
    small, large = (pa.table({"a": pa.array([1, 2], kind)}) for kind in (pa.int32(), pa.int64()))
    assert table_digest(small) != table_digest(large)


def pickle_arrays() -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, labels=np.array([{"code": "here"}], object), margin=labels()["margin"])
    return buffer.getvalue()


@pytest.mark.parametrize("damage", ["missing", "cut", "altered", "empty", "swapped", "pickled"])
def test_get_error_names_a_damaged_file_in_one_sentence(store, damage):
    ref, second = store.put("labels", labels(3)), store.put("labels", labels(4))
    path = f"{store.path}/{ref.uri}"
    content = store.fs.cat_file(path)
    if damage == "missing":
        store.fs.rm_file(path)
    else:
        bad = {
            "cut": content[: len(content) // 2],
            "altered": content[:90] + bytes([content[90] ^ 255]) + content[91:],
            "empty": b"",
            "swapped": store.fs.cat_file(f"{store.path}/{second.uri}"),
            "pickled": pickle_arrays(),
        }[damage]
        store.fs.pipe_file(path, bad)
    with pytest.raises(SpecError, match=rf"^[^\n]*{ref.uri}[^\n]*found[^\n]*expected[^\n]*$"):
        store.get(ref)
    assert store.put("labels", labels(3)) == ref
    assert store.fs.cat_file(path) == content


@pytest.mark.parametrize(
    ("root", "why"),
    [
        ("foo://bucket", "Protocol not known: foo; or choose a folder"),
        ("s3a://bucket", r"needs s3fs \(`pip install 's3fs>=\d"),
    ],
)
def test_store_refuses_unknown_protocol_and_missing_package(root, why, monkeypatch):
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(InputError, match=f"store {root}: {why}"):
        ArtifactStore(root)


def test_put_and_get_refuse_content_that_breaks_its_spec(local):
    wrong = {**labels(), "margin": np.zeros((2, 4, 5), np.float64)}
    with pytest.raises(SpecError, match=r"margin: found float64 .*expected float32"):
        local.put("labels", wrong)
    assert not Path(local.path).exists()
    ref = local.put("labels", labels())
    find_file(local, ref).write_bytes(encode_arrays(wrong, load_spec("labels")))
    with pytest.raises(SpecError, match=f"{ref.digest}.npz: margin: found float64"):
        local.get(ref)


def test_interrupted_put_leaves_no_file(local, monkeypatch):
    ref = local.put("labels", labels(1))
    before = sorted(Path(local.path).rglob("*"))

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    monkeypatch.setattr(os, "link", interrupt)
    with pytest.raises(KeyboardInterrupt):
        local.put("labels", labels(2))
    after = [p for p in sorted(Path(local.path).rglob("*")) if p.is_file() or p in before]
    assert after == before
    local.get(ref)


@pytest.mark.parametrize(
    "below",
    [
        "file",
        pytest.param(
            "locked",
            marks=pytest.mark.skipif(
                sys.platform == "win32" or os.geteuid() == 0, reason="root may write anywhere"
            ),
        ),
    ],
)
def test_check_writable_refuses_a_folder_without_access(tmp_path, below):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "locked").mkdir(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(InputError, match=r"cannot write there .*--store"):
        ArtifactStore(tmp_path / below / "store").check_writable()
