"""Versions of weights: the current one always exists, and none is lost."""

import multiprocessing
import os

import pyarrow as pa
import pytest

from slgaussian.errors import InputError, SpecError
from slgaussian.semantic.versions import Versions
from slgaussian.storage.encoding import encode_table
from slgaussian.storage.specs import load_spec


@pytest.fixture
def versions(tmp_path):
    return Versions(tmp_path / "models")


def test_versions_keep_all_and_use_one(versions):
    assert versions.current() is None and versions.all() == []
    first = versions.add(b"one", {"iou": 0.5}, True, "the first")
    second = versions.add(b"two", {"iou": 0.6}, True, "better by 0.1", first)
    third = versions.add(b"three", {"iou": 0.6}, False, "no gain beyond noise", second)
    assert [v.number for v in (first, second, third)] == [1, 2, 3]
    assert [(v.parent, v.promoted) for v in versions.all()] == [(0, True), (1, True), (2, False)]
    assert versions.all() == [first, second, third]
    assert versions.current() == second and versions.current().facts == {"iou": 0.6}
    assert versions.weights(third).read_bytes() == b"three"
    for version in (first, third, None, None):
        versions.use(version)
        assert versions.current() == version
    assert len(versions.all()) == 3


def test_add_promotes_only_over_the_version_it_was_compared_with(versions):
    """Another version is promoted while a candidate is trained."""
    first = versions.add(b"one", {}, True, "the first")
    versions.use(None)
    late = versions.add(b"two", {}, True, "better by 0.1", first)
    assert not late.promoted and versions.current() is None
    assert late.why == "no version came into use while it was trained; better by 0.1"
    assert versions.all() == [first, late]


def test_current_ignores_a_history_of_earlier_releases(versions):
    first = versions.add(b"one", {}, True, "the first")
    change = '{"when": "", "version": 1, "before": 0, "by": "ada", "why": ""}'
    (versions.folder / "current.json").write_text(f'{{"version": 1, "history": [{change}]}}')
    assert versions.current() == first


def test_add_keeps_the_version_in_use_after_a_failure(versions, monkeypatch):
    first = versions.add(b"one", {}, True, "the first")
    replace = os.replace

    def full(source, target):
        if str(target).endswith(".parquet"):
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputError, match="No space left on device"):
        versions.add(b"two", {}, True, "better")
    monkeypatch.undo()
    assert versions.current() == first and versions.all() == [first]
    assert versions.add(b"two", {}, True, "better", first).number == 2


def test_versions_name_damaged_files(versions):
    first = versions.add(b"one", {}, True, "the first")
    second = versions.add(b"two", {}, False, "the second")
    versions.weights(first).write_bytes(b"other")
    for ask in (versions.weights, versions.use):
        with pytest.raises(SpecError, match=r"\.safetensors: missing or altered"):
            ask(first)
    numbers = ["1e400", "NaN", "-Infinity", "1" * 400, "true", '"1"', "1.0", "-1", "[1]"]
    texts = ["{", "[]", '{"version": 9}']
    texts += [f'{{"version": {number}}}' for number in numbers]
    for text in texts:
        (versions.folder / "current.json").write_text(text)
        with pytest.raises(SpecError, match=r"current\.json: cannot be read|000009"):
            versions.current()
    versions.use(second)
    assert versions.current() == second
    # A version is not its own ancestor.
    file, spec = versions.folder / "versions" / "000001.parquet", load_spec("versions")
    row = {**vars(first), "facts": "{}", "parent": 1}
    file.write_bytes(encode_table(pa.Table.from_pylist([row], schema=spec.schema), spec))
    with pytest.raises(SpecError, match="version 1 of parent 1"):
        versions.version(1)


def _add(folder, number):
    versions = Versions(folder)
    current = versions.current()
    added = versions.add(b"%d" % number, {"by": number}, True, "at the same time", current)
    assert added.promoted or added.why.endswith(
        "came into use while it was trained; at the same time"
    )


def test_add_numbers_concurrent_versions(tmp_path):
    # Not forked: after other tests this process has threads, which forks do not survive.
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=_add, args=(tmp_path, n)) for n in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
        assert worker.exitcode == 0
    versions = Versions(tmp_path).all()
    assert [v.number for v in versions] == [1, 2, 3, 4]
    assert sorted(v.facts["by"] for v in versions) == list(range(4))
    assert Versions(tmp_path).current() == [version for version in versions if version.promoted][-1]
