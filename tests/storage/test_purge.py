"""Traces of a clip in files of any kind, and what a store has computed from it."""

import hashlib
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from contents import failures, labels

from slgaussian import datasets
from slgaussian.datasets import re10k
from slgaussian.datasets.purge import Traces, find_derived_files, search_store
from slgaussian.datasets.shards import make_key
from slgaussian.storage.encoding import encode_artifact
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore

PHOTOGRAPH = hashlib.sha256(b"photograph").hexdigest()
TRACES = Traces(frozenset({"büro 1"}), frozenset({PHOTOGRAPH}))


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.txt", "the büro 1.", True),
        ("a.txt", "the büro 10", False),
        ("a.txt", "a-büro 1", False),
        ("a.json", '"b\\u00fcro 1"', True),
        ("a.tar", f"{make_key('büro 1')}_0003_0012.jpg", True),
        ("a.csv", PHOTOGRAPH, True),
        ("a.jpg", "photograph", True),
        ("a.jpg", "another", False),
    ],
)
def test_is_in_file_finds_whole_words_and_photographs(name, text, expected):
    assert TRACES.is_in_file(name, text.encode()) is expected


def test_is_in_file_searches_compressed_files():
    table = encode_artifact("failures", failures("büro 1"), "t")[1]
    other = encode_artifact("failures", failures("büro 10"), "t")[1]
    assert TRACES.is_in_file("t.parquet", table) and not TRACES.is_in_file("t.parquet", other)
    room = datasets.load("procedural", seed=1, objects=1, views=2, height=24, width=32)
    clip = re10k.encode_clip(room)
    chunk = re10k.encode_chunk([clip])
    same = hashlib.sha256(clip.images[1]).hexdigest()
    packed = encode_artifact("packed", {"torch": np.frombuffer(chunk, np.uint8)}, "p")[1]
    for traces, expected in (
        (replace(TRACES, photographs=frozenset({same})), True),
        (TRACES, False),
    ):
        assert traces.is_in_file("000000.torch", chunk) is expected
        assert traces.is_in_file("p.npz", packed) is expected


def test_cut_from_removes_rows_and_clears_names_in_nullable_columns():
    fields = [
        pa.field("clip", "string", False),
        pa.field("other", "string"),
        pa.field("place", "string"),
    ]
    rows = [("büro 1", "b", "p"), ("b", "büro 1", "büro 1"), ("c", None, "p")]
    table = pa.table(list(zip(*rows, strict=True)), schema=pa.schema(fields))
    cut = TRACES.cut_from(table)
    # The place keeps its name, by which its side of a split is known.
    assert [tuple(row.values()) for row in cut.to_pylist()] == [("b", None, "büro 1"), rows[2]]


def test_find_derived_files_keeps_artifacts_shared_with_other_records(store: ArtifactStore):
    def key(stage: str) -> str:
        return f"{stage}/v1/{hashlib.sha256(stage.encode()).hexdigest()}"

    records = Records(store)
    named = store.put("failures", failures("büro 1"))
    shared, alone, far, free = (store.put("labels", labels(value)) for value in range(4))
    for stage, ref, inputs in (
        ("views", named, {}),
        (
            "masks",
            replace(alone, meta={"parts": [shared.uri]}),
            {"inputs": {"table": named.digest}},
        ),
        ("train", far, {"settings": {"all": [{"spec": "labels", "digest": alone.digest}]}}),
        ("other", free, {"parts": [shared.uri]}),
    ):
        records.keep(key(stage), replace(ref, meta={**ref.meta, **inputs}))
    store.write("notes.txt", "of büro 1, by the user".encode())
    count, marked = search_store(store, TRACES)
    assert count == 10 and marked == {named.uri, "notes.txt"}
    files = find_derived_files(store, marked)
    gone = {named.uri, alone.uri, far.uri}
    assert {uri for uri in files if not uri.startswith("keys/")} == gone and files[-1] == named.uri
    assert [
        stage
        for stage in ("views", "masks", "train", "other")
        for uri in files
        if f"/{stage}/" in uri
    ] == ["views", "masks", "train"]
