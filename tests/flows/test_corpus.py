"""A corpus of chunks: new files are read once, and damaged ones cost no others."""

import hashlib
import os
import re
import shutil
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from command import files_below, save_photographs

from flows import clip_sources, corpus
from flows.clip_sources import find_sources
from flows.config import CorpusSettings
from flows.read_config import make_settings
from flows.runners.environment import call_flow
from slgaussian import datasets
from slgaussian.components.config import ComponentConfig
from slgaussian.datasets import re10k
from slgaussian.errors import InputError
from slgaussian.semantic.lesson import Lesson
from slgaussian.storage.store import ArtifactRef, ArtifactStore

pytestmark = pytest.mark.usefixtures("server")


def make_clip(seed: int, views: int = 6) -> re10k.Clip:
    size = {"height": 90, "width": 160}
    room = datasets.load("procedural", seed=seed, objects=4, views=views, baseline=1.0, **size)
    return re10k.encode_clip(room)


@pytest.fixture(scope="module")
def clips():
    return [make_clip(seed) for seed in range(3)]


def make_old(folder: Path) -> None:
    """Give chunks an old modification time."""
    for file in folder.glob("*.torch"):
        os.utime(file, (time.time() - 60,) * 2)


def settings_for(folder: Path, **extra):
    values = {"sources": [str(folder / "chunks")], "out": folder / "out", "size": "72x96", **extra}
    return make_settings(values, "test", CorpusSettings)


def run_flow(command: str, settings, store: ArtifactStore) -> corpus.Prepared:
    flow = {"ingest": corpus.ingest_corpus, "supervise": corpus.supervise_corpus}[command]
    return call_flow(flow, settings.model_copy(update={"store": store.root}))


def table(folder: Path, name: str) -> list[dict]:
    return pq.read_table(folder / "out" / f"{name}.parquet").to_pylist()


TIMED = ("log.",)
"""What says how long things took, and so is another in every store."""


@pytest.fixture
def reads(monkeypatch):
    """Count how often chunks are ``hashed`` and ``opened``, and samples ``predicted``."""
    counts, load = Counter(), ComponentConfig.load

    def count(name, function):
        def call(*args, **kwargs):
            counts[name] += 1
            return function(*args, **kwargs)

        return call

    def load_counted(part, *args):
        output = load(part, *args)
        return count("predicted", output) if part.kind == "predictor" else output

    monkeypatch.setattr(hashlib, "file_digest", count("hashed", hashlib.file_digest))
    monkeypatch.setattr(re10k, "read_chunk", count("opened", re10k.read_chunk))
    monkeypatch.setattr(ComponentConfig, "load", load_counted)

    def take():
        picked = dict(counts)
        counts.clear()
        return picked

    return take


@pytest.fixture(scope="module")
def lesson_corpus(tmp_path_factory, clips, server):
    """Two chunks, supervised."""
    folder = tmp_path_factory.mktemp("corpus")
    for clip in clips[:2]:
        re10k.write(folder / "chunks", [clip])
    make_old(folder / "chunks")
    store = ArtifactStore(folder / "store")
    return folder, store, run_flow("supervise", settings_for(folder), store)


def test_every_view_and_sample_is_in_a_table_and_every_sample_has_a_lesson(lesson_corpus, clips):
    folder, store, output = lesson_corpus
    views = table(folder, "views")
    assert [(v["chunk"], v["clip"], v["frame"]) for v in views] == [
        (f"chunks/00000{n}.torch", clip.key, frame)
        for n, clip in enumerate(clips[:2])
        for frame in range(6)
    ]
    first = np.array([views[0][name] for name in ("fx", "fy", "cx", "cy", "w2c_00", "w2c_23")])
    np.testing.assert_array_equal(first, clips[0].cameras[0, [0, 1, 2, 3, 6, 17]])
    assert all(2 < view["depth"] < 5 for view in views)
    samples = table(folder, "pairs")
    assert {sample["clip"] for sample in samples} == {clip.key for clip in clips[:2]}
    for sample in samples:
        (first, last), between = sample["context"], sample["targets"]
        assert len(between) == 3 and first < between[0] < between[1] < between[2] < last
        assert sample["overlap"] >= 0.6 and sample["baseline"] >= 0.08
    assert table(folder, "failures") == [] == output.failures
    assert output.rows == {"views": 12, "pairs": len(samples), "lessons": len(samples)}
    rows = table(folder, "lessons")
    assert [row["sample"] for row in rows] == [row["sample"] for row in samples]
    for row in rows:
        lesson = Lesson.from_arrays(store.get(ArtifactRef("lesson", row["uri"], row["digest"])))
        assert lesson.sample == row["sample"]
        assert lesson.labels.shape == (2, 72, 96) and lesson.targets.shape == (3, 72, 96)
        valid = set(np.unique(lesson.labels)) - {0}
        assert row["objects"] == len(valid) > 2
        assert set(np.unique(lesson.targets)) - {0} <= valid
        assert row["unlabelled_context"] == (lesson.labels == 0).mean()
        assert row["unlabelled_target"] == (lesson.targets == 0).mean() < 0.2


def test_lessons_of_a_clip_are_equal_beside_other_clips_of_its_chunk(
    lesson_corpus, clips, server, tmp_path
):
    re10k.write(tmp_path / "chunks", clips[:2])
    make_old(tmp_path / "chunks")
    run_flow("supervise", settings_for(tmp_path), ArtifactStore(tmp_path / "store"))
    alone = {row["sample"]: row["digest"] for row in table(lesson_corpus[0], "lessons")}
    assert {row["sample"]: row["digest"] for row in table(tmp_path, "lessons")} == alone


def test_ingest_and_supervise_read_only_new_chunks(lesson_corpus, clips, reads, tmp_path):
    folder, store, _ = lesson_corpus
    before = files_below(folder / "out", TIMED)
    run_flow("supervise", settings_for(folder), store)
    assert reads() == {}
    assert files_below(folder / "out", TIMED) == before
    for file in (folder / "chunks").glob("*.torch"):
        os.utime(file)
    make_old(folder / "chunks")
    run_flow("ingest", settings_for(folder, out=tmp_path), store)
    assert reads() == {"hashed": 2}
    extra = tmp_path / "corpus"
    shutil.copytree(folder / "chunks", extra / "chunks")
    re10k.write(extra / "chunks", [clips[2]])
    make_old(extra / "chunks")
    run_flow("ingest", settings_for(extra), store)
    assert reads() == {"hashed": 3, "opened": 1}
    assert len(table(extra, "views")) == 18


def test_supervise_computes_a_lost_lesson_again(lesson_corpus, reads):
    folder, store, _ = lesson_corpus
    row = table(folder, "lessons")[0]
    file = Path(store.path) / row["uri"]
    complete = file.read_bytes()
    file.unlink()
    run_flow("supervise", settings_for(folder), store)
    assert file.read_bytes() == complete
    assert reads() == {"opened": 1}


def test_another_store_and_worker_count_give_the_same_bytes(lesson_corpus, tmp_path):
    folder, _, _ = lesson_corpus
    store = ArtifactStore(tmp_path / "store")
    sources = [str(folder / "chunks")]
    run_flow("supervise", settings_for(tmp_path, sources=sources, workers=1), store)
    assert files_below(tmp_path / "out", TIMED) == files_below(folder / "out", TIMED)
    lessons = files_below(tmp_path / "store" / "lesson")
    assert lessons.items() <= files_below(folder / "store" / "lesson").items()


def test_ingest_leaves_out_damaged_chunks_clips_and_frames_only(clips, tmp_path):
    good, bad, short = clips[0], clips[1], make_clip(9, views=4)
    cameras = bad.cameras.copy()
    cameras[1, 6:9] *= 3
    images = list(bad.images)
    images[5] = images[5][: len(images[5]) // 2]
    bad = replace(bad, cameras=cameras, images=tuple(images))
    dead = replace(short, key="dead", images=(b"x",) * 4)
    re10k.write(tmp_path / "chunks", [bad, short, dead, good])
    re10k.write(tmp_path / "chunks", [clips[2]])
    re10k.write(tmp_path / "chunks", [replace(good, key="new")])
    twice = tmp_path / "chunks" / "000009.torch"
    twice.write_bytes((tmp_path / "chunks" / "000002.torch").read_bytes())
    cut = tmp_path / "chunks" / "000001.torch"
    cut.write_bytes(cut.read_bytes()[:5000])
    output = run_flow("ingest", settings_for(tmp_path), ArtifactStore(tmp_path / "store"))
    message = {(row["scene"], row["stage"]): row["reason"] for row in table(tmp_path, "failures")}
    reasons = " ".join(row["reason"] for row in table(tmp_path, "failures"))
    assert "000001.torch: cannot be read as a chunk" in message["chunks/000001.torch", "views"]
    assert re.search("clip 'procedural_1', frame 1: .* is not a rotation", reasons)
    assert "clip 'procedural_1', frame 5: its JPEG cannot be decoded" in reasons
    assert "clip 'procedural_1': 4 of its 4 views are sharp" in message["procedural_1", "pairs"]
    assert "clip 'procedural_9': 4 of its 4 views" in message["procedural_9", "pairs"]
    assert "clip 'dead': none of its 4 frames can be used" in reasons
    assert (
        "clip 'new' of chunks/000009.torch is also in chunks/000002.torch"
        in message["new", "views"]
    )
    # Three more are of the four frames of "dead", and the last of all.
    assert len(output.failures) == 11
    assert {sample["clip"] for sample in table(tmp_path, "pairs")} == {good.key, "new"}
    frames = {view["frame"] for view in table(tmp_path, "views") if view["clip"] == bad.key}
    assert frames == {0, 2, 3, 4}


NAMES = ("view_00", "view_01", "view_02")


def test_scenes_become_clips_of_chunks(clips, tmp_path, monkeypatch):
    monkeypatch.setattr(clip_sources, "ROOM_OPTIONS", {"views": 2, "height": 36, "width": 64})
    re10k.write(tmp_path / "chunks", [clips[0]])
    for name, seed in (("kitchen", 1), ("hall", 2), ("bad", 3)):
        save_photographs(tmp_path / name, names=NAMES, seed=seed)
    (tmp_path / "kitchen" / "view_01.png").write_bytes(b"no image")
    (tmp_path / "bad" / "transforms.json").write_text("{")
    names = ("chunks", "kitchen", "bad/transforms.json")
    settings = settings_for(tmp_path, sources=[str(tmp_path / name) for name in names])
    store = ArtifactStore(tmp_path / "store")
    output = run_flow("ingest", settings, store)
    out = tmp_path / "out" / "chunks"
    assert re10k.read_index(out) == {"kitchen": "000000.torch"}
    (clip,) = re10k.read_chunk(out / "000000.torch")
    expected = datasets.load("nerfstudio", tmp_path / "kitchen").cameras["view_00.png"]
    np.testing.assert_allclose(clip.view(0).camera.c2w, expected.c2w, atol=1e-6)
    assert len(clip.images) == 2 and output.rows["views"] == 6 + 2
    reasons = {(row["scene"], row["stage"]): row["reason"] for row in table(tmp_path, "failures")}
    assert "view_01.png: cannot be read" in reasons["kitchen", "packed"]
    assert "transforms.json" in reasons["bad", "packed"]
    # What is there stays as it is, and what was withdrawn is not added.
    before = (out / "000000.torch").read_bytes()
    sources = [*(str(tmp_path / name) for name in ("kitchen", "hall")), "procedural:7"]
    (tmp_path / "withdrawn").write_text("procedural_7\n")
    extra = {"sources": sources, "withdrawn": tmp_path / "withdrawn"}
    run_flow("ingest", settings_for(tmp_path, **extra), store)
    assert re10k.read_index(out) == {"kitchen": "000000.torch", "hall": "000001.torch"}
    assert (out / "000000.torch").read_bytes() == before


@pytest.mark.parametrize(
    "named", ["garden", "garden/sparse/0", "garden/colmap/sparse/0", "garden/transforms.json"]
)
def test_find_sources_names_a_scene_after_its_folder(tmp_path, named):
    place = tmp_path / named
    if place.suffix:
        place.parent.mkdir()
        (tmp_path / "elsewhere").touch()
        place.symlink_to(tmp_path / "elsewhere")
    else:
        place.mkdir(parents=True)
    assert [source.name for source in find_sources([str(place), "there=procedural:3-4"])] == [
        "garden", "procedural_3", "procedural_4",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("sources", "reason"),
    [
        (["procedural:4-3"], "procedural:4-3: found no seeds"),
        (["procedural:1", "procedural:1-2"], "its clip would be called 'procedural_1'"),
        (["nowhere"], "nowhere: is not there; expected a folder of photographs"),
    ],
)
def test_find_sources_refuses_bad_sources_in_one_sentence(sources, reason):
    with pytest.raises(InputError, match=reason):
        find_sources(sources)


def test_the_command_prints_its_tables_and_what_it_left_out(lesson_corpus, tmp_path, slg):
    folder, store, _ = lesson_corpus
    shutil.copytree(folder / "chunks", tmp_path / "chunks")
    words = ("ingest", tmp_path / "chunks", "-o", tmp_path / "out", "--store", store.path)
    status, out, errors = slg(*words)
    assert status == 0 and "left out" not in errors
    assert f"12 views  {tmp_path / 'out' / 'views.parquet'}" in out
    (tmp_path / "chunks" / "000000.torch").write_bytes(b"PK")
    status, out, errors = slg(*words)
    assert status == 1 and "6 views" in out
    assert "left out: 1, the first at views: " in errors and "failures.parquet" in errors
