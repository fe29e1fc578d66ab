"""Files that garbage collection keeps and removes, and damaged files."""

import json
from pathlib import Path

import pytest
from contents import failures, labels

from slgaussian.storage.housekeeping import collect
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore

VERSIONS = {"a": 1, "b": 2}
KEYS = {stage: f"{stage}/v{version}/{stage * 9:f<64.64}" for stage, version in VERSIONS.items()}


def names(store: ArtifactStore) -> set[str]:
    return {file.uri for files in store.walk() for file in files}


def fill_store(store: ArtifactStore) -> dict[str, str]:
    """Paths of artifacts: of stage a, of stage b with a part, and one that nothing refers to."""
    a, b, part, loose = (store.put("labels", labels(value)) for value in range(4))
    Records(store).keep(KEYS["a"], a)
    table = store.put("failures", failures("x"), {"parts": [part.uri, b.uri]})
    Records(store).keep(KEYS["b"], table)
    return {"a": a.uri, "b": b.uri, "part": part.uri, "loose": loose.uri, "table": table.uri}


def test_collect_removes_only_unreferenced_artifacts(store):
    uris = fill_store(store)
    store.write("digests/abc.json", b"{}")
    store.write("notes.txt", b"of the user")
    before = names(store)
    garbage = collect(store, -60, VERSIONS)
    assert (garbage.artifacts, garbage.records, garbage.kept) == (1, 0, 4)
    assert garbage.bytes == len(store.read(uris["loose"]))
    assert names(store) == before
    assert collect(store, -60, VERSIONS, delete=True) == garbage
    assert names(store) == before - {uris["loose"]}
    assert collect(store, -60, VERSIONS, delete=True).artifacts == 0
    assert all(Records(store).find(key) for key in KEYS.values())


def test_collect_keeps_young_artifacts(store):
    uris = fill_store(store)
    garbage = collect(store, 3600, VERSIONS, delete=True)
    assert (garbage.artifacts, garbage.young) == (0, 1)
    assert uris["loose"] in names(store)


def test_collect_removes_records_of_other_versions_and_their_artifacts(store):
    uris = fill_store(store)
    assert collect(store, -60, {"b": 2, "other": 1}).records == 0
    garbage = collect(store, -60, {"a": 1, "b": 3}, delete=True)
    assert (garbage.records, garbage.artifacts) == (1, 4)
    remaining = {uri for uri in names(store) if not uri.startswith("keys/")}
    assert remaining == {uris["a"]}
    assert Records(store).find(KEYS["b"]) is None


def test_collect_removes_temporary_files_of_killed_programs(local):
    ref = local.put("labels", labels())
    Records(local).keep(KEYS["a"], ref)
    folder = Path(local.path) / ref.uri
    left = [
        folder.with_name(f".{ref.digest}.npz.0123abcd.tmp"),
        Path(local.path) / f".probe-{'0' * 32}",
        Path(local.path)
        / KEYS["a"].replace("a/", "keys/a/", 1).rsplit("/", 1)[0]
        / ".x.json.1.tmp",
    ]
    for path in left:
        path.write_bytes(b"half")
    foreign = Path(local.path) / "checkpoints" / ".going-on.tmp"
    foreign.parent.mkdir()
    foreign.write_bytes(b"not ours")
    assert collect(local, 3600, VERSIONS, delete=True).unfinished == 0
    assert collect(local, -60, VERSIONS, delete=True).unfinished == 3
    assert not any(path.exists() for path in left)
    assert foreign.exists()


RECORDS = {
    "not JSON": b"\x80\x04\x95",
    "no ref": b"{}",
    "a place outside": json.dumps(
        {"spec": "labels", "uri": "labels/../../../../etc/passwd", "digest": "0" * 64}
    ).encode(),
    "parts that are no paths": json.dumps(
        {"spec": "labels", "uri": f"labels/00/{'0' * 64}.npz", "digest": "0" * 64,
         "meta": {"parts": [1]}}
    ).encode(),
}  # fmt: skip


@pytest.mark.parametrize("data", RECORDS.values(), ids=RECORDS)
def test_collect_removes_an_unreadable_record_and_its_artifact(local, data):
    ref = local.put("labels", labels())
    Records(local).keep(KEYS["a"], ref)
    (record,) = (record for some in Records(local).all() for record in some)
    (Path(local.path) / record.file.uri).write_bytes(data)
    assert Records(local).find(KEYS["a"]) is None
    assert collect(local, -60, VERSIONS, delete=True).records == 1
    assert names(local) == set()
