"""A training set: its content, its reproducibility, and its readers."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
from collections import defaultdict
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from command import files_below, write_photographs

from flows import dataset
from flows.config import DatasetSettings
from flows.read_config import make_settings
from slgaussian import datasets
from slgaussian.datasets import TrainingSet, re10k
from slgaussian.errors import InputError, SpecError
from slgaussian.io import file_sha256
from slgaussian.semantic.versions import Versions, mark_clip
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore, parse_uri
from tests.json_documents import read_document

pytestmark = pytest.mark.usefixtures("server")

SMALL = {"size": "72x96", "targets": 1, "most": 1, "held_out": 0.5, "shard_mb": 0.1}


def room(seed: int, views: int = 4):
    size = {"height": 90, "width": 160}
    return datasets.load("procedural", seed=seed, objects=4, views=views, baseline=1.0, **size)


def write_folder(scene, folder: Path) -> Path:
    """The scene as a nerfstudio folder."""
    views = {f"images/{i}.png": scene.read(name) for i, name in enumerate(scene.cameras)}
    write_photographs(folder, views)
    return folder


def settings_for(folder: Path, *sources, **extra):
    inputs = [str(source) for source in sources]
    return make_settings(
        {**SMALL, "out": folder / "set", "sources": inputs, **extra}, "dataset", DatasetSettings
    )


def make_set(settings, store: ArtifactStore) -> dataset.TrainingSetResult:
    return dataset.make_training_set(settings.model_copy(update={"store": store.root}))


@pytest.fixture(scope="module")
def output(tmp_path_factory, server):
    """Build a set of two chunks with a clip each and a folder, of the place of the first clip."""
    folder = tmp_path_factory.mktemp("dataset")
    for seed in (0, 1):
        re10k.write(
            folder / "chunks", [replace(re10k.encode_clip(room(seed)), url=f"https://video/{seed}")]
        )
    for file in (folder / "chunks").glob("*.torch"):
        os.utime(file, (time.time() - 60,) * 2)
    kitchen = write_folder(room(2), folder / "kitchen")
    store = ArtifactStore(folder / "store")
    settings = settings_for(folder, folder / "chunks", f"here={kitchen}")
    return folder, store, settings, make_set(settings, store)


def test_every_sample_is_in_the_index_and_in_a_shard(output):
    folder, _, _, message = output
    rows = pq.read_table(folder / "set/index.parquet").to_pylist()
    assert (message.samples, message.places, message.failures) == (3, 3, [])
    assert {row["place"] for row in rows} == {"https://video/0", "https://video/1", "here"}
    names = defaultdict(list)
    for shard in sorted((folder / "set").glob("*.tar")):
        with tarfile.open(shard) as archive:
            names[shard.name] = [name.partition(".")[0] for name in archive.getnames()]
    for row in rows:
        assert row["sample"] in names[row["shard"]] and row["shard"].startswith(row["split"])
        assert row["context"][0] < row["targets"][0] < row["context"][1]
        assert row["overlap"] > 0.6 and row["baseline"] > 0.08 and 0 < row["confirmed"] <= 1
        assert (row["height"], row["width"]) == (72, 96)
        data = (folder / "set" / row["shard"]).read_bytes()
        refs = data[row["offset"] : row["offset"] + row["bytes"]]
        assert hashlib.sha256(refs).hexdigest() == row["digest"]
    assert message.shards == len(names) and sum(len(set(refs)) for refs in names.values()) == 3


def test_an_item_holds_what_the_scene_shows(output):
    folder, *_ = output
    samples = TrainingSet(folder / "set", where=pc.field("clip") == "kitchen")
    item = samples[0]
    assert (len(samples), item["place"]) == (1, "here")
    frames = samples.rows.to_pylist()[0]
    scene = room(2)
    names = list(scene.cameras)
    for role, refs in (("context", frames["context"]), ("target", frames["targets"])):
        for view, frame in enumerate(refs):
            truth = scene.read(names[frame]).resize(72, 96)
            image = item[role]["image"][view].numpy().transpose(1, 2, 0)
            assert np.abs(image.astype(int) - truth.image).mean() < 4  # noise, JPEG twice
            np.testing.assert_allclose(item[role]["K"][view], truth.camera.K, atol=1e-3)
            np.testing.assert_allclose(item[role]["c2w"][view], truth.camera.c2w, atol=1e-5)
            depth = item[role]["depth"][view].numpy()
            error = np.abs(depth - truth.depth) / truth.depth
            assert np.median(error) < 0.1 and (depth > 0).mean() > 0.9
    ids = set(item["objects"]["ids"].tolist())
    assert set(item["context"]["labels"].unique().tolist()) - {0} == ids
    assert set(item["target"]["labels"].unique().tolist()) - {0} <= ids
    assert item["objects"]["codes"].shape == (len(ids), 3)
    lengths = item["objects"]["features"].norm(dim=-1)[item["objects"]["present"]]
    np.testing.assert_allclose(lengths, 1, atol=2e-3)
    assert "gaussians" not in item and item["quality"]["overlap"] == frames["overlap"]


READ = """
import hashlib, json, sys
import torch
from torch.utils.data import DataLoader
from slgaussian.datasets import TrainingSet

def digest(value):
    if isinstance(value, dict):
        return {name: digest(own) for name, own in value.items()}
    if isinstance(value, torch.Tensor):
        return hashlib.sha256(value.numpy().tobytes()).hexdigest()
    return value

samples = TrainingSet(sys.argv[1])
for workers, seed in ((0, 0), (2, 0), (0, 1), (0, 2), (0, 3), (0, 4), (0, 5)):
    loader = DataLoader(
        samples, batch_size=2, shuffle=True, num_workers=workers,
        generator=torch.Generator().manual_seed(seed),
    )
    print(json.dumps([digest(batch) for batch in loader]))
"""


def test_workers_and_shuffling_change_no_byte(output):
    folder, *_ = output
    # In a process of its own, as a training is: this one has a server's threads, and workers fork.
    command = [sys.executable, "-c", READ, str(folder / "set")]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    alone, two, *shuffled = map(json.loads, lines)
    assert [len(batch["sample"]) for batch in alone] == [2, 1] and two == alone
    orders = {tuple(name for batch in first for name in batch["sample"]) for first in shuffled}
    names = pq.read_table(folder / "set/index.parquet")["sample"].to_pylist()
    assert len(orders) > 1 and {frozenset(order) for order in orders} == {frozenset(names)}


def test_dataset_writes_only_new_shards(output, tmp_path):
    folder, store, settings, _ = output
    shutil.copytree(folder / "set", tmp_path / "set")
    before = files_below(tmp_path / "set")
    rerun = settings_for(tmp_path, *settings.sources)
    assert make_set(rerun, store).new_shards == 0
    assert files_below(tmp_path / "set") == before
    afresh = settings_for(tmp_path / "other", *settings.sources)
    make_set(afresh, store)
    assert files_below(tmp_path / "other/set") == before

    extra = write_folder(room(6), tmp_path / "hall")
    grown = make_set(settings_for(tmp_path, *settings.sources, extra), store)
    after = files_below(tmp_path / "set")
    shards = {name for name in before if name.endswith(".tar")}
    assert grown.samples == 4 and grown.new_shards == 1
    assert all(after[name] == before[name] for name in shards)
    assert len({name for name in after if name.endswith(".tar")} - shards) == 1


def test_dataset_drops_withdrawn_clips_and_rewrites_damaged_shards(output, tmp_path):
    folder, store, settings, _ = output
    shutil.copytree(folder / "set", tmp_path / "set")
    before = files_below(tmp_path / "set")
    rows = pq.read_table(tmp_path / "set/index.parquet").to_pylist()
    row = next(row for row in rows if row["clip"] != "kitchen")
    shard = tmp_path / "set" / row["shard"]
    data = shard.read_bytes()
    shard.write_bytes(data[:600] + b"\xff" + data[601:])
    make_set(settings_for(tmp_path, settings.sources[0], keep_old_days=0), store)
    rows = pq.read_table(tmp_path / "set/index.parquet").to_pylist()
    assert "kitchen" not in {refs["clip"] for refs in rows} and len(rows) == 2
    result = {refs["sample"]: refs for refs in rows}[row["sample"]]
    assert result["shard"] != row["shard"] and result["digest"] == row["digest"]
    assert not shard.exists()
    assert TrainingSet(tmp_path / "set").members(0)
    full = b"".join(
        data for name, data in files_below(tmp_path / "set").items() if name[-3:] == "tar"
    )
    assert b"kitchen" not in full and any(b"kitchen" in data for data in before.values())


def manifests(folder: Path) -> list[dict]:
    """The manifests of a set, each checked against its spec."""
    spec = load_spec("set_version")
    files = sorted((folder / "set/versions").iterdir())
    return [read_document(file.read_bytes(), spec, file.name) for file in files]


def card(folder: Path) -> str:
    return (folder / "set/README.md").read_text()


def test_a_reader_that_is_open_reads_on_after_an_update_until_the_delay_ends(output, tmp_path):
    folder, store, settings, _ = output
    shutil.copytree(folder / "set", tmp_path / "set")
    reader = TrainingSet(tmp_path / "set")
    rows = reader.rows.to_pylist()
    kitchen = settings_for(tmp_path, settings.sources[1])
    assert make_set(kitchen, store).version == 2 and len(TrainingSet(tmp_path / "set")) == 1
    assert [reader[n]["sample"] for n in range(3)] == [row["sample"] for row in rows]
    shards = {row["shard"] for row in rows if row["clip"] != "kitchen"}
    retired = json.loads((tmp_path / "set/retired.json").read_text())
    assert set(retired) == shards and not [s for s in shards if s in card(tmp_path)]
    long_ago = [datetime.fromisoformat(time) - timedelta(days=7) for time in retired.values()]
    changed = dict(zip(retired, map(str, long_ago), strict=True))
    (tmp_path / "set/retired.json").write_text(json.dumps(changed))
    assert make_set(kitchen, store).version == 2
    assert not shards & set(os.listdir(tmp_path / "set"))
    assert not (tmp_path / "set/retired.json").exists()
    # Names of shards are not given again: a reader may still expect the old ones.
    assert make_set(settings_for(tmp_path, *settings.sources), store).version == 3
    assert (
        not shards & set(os.listdir(tmp_path / "set")) and len(TrainingSet(tmp_path / "set")) == 3
    )
    with pytest.raises(SpecError, match="cannot be read"):
        [reader[n] for n in range(3)]


def test_a_manifest_says_what_came_and_went_and_why(output, tmp_path):
    folder, store, settings, _ = output
    shutil.copytree(folder / "set", tmp_path / "set")
    chunks, kitchen = settings.sources
    (tmp_path / "withdrawn").write_text("procedural_1\n")
    make_set(settings_for(tmp_path, chunks, kitchen, withdrawn=tmp_path / "withdrawn"), store)
    make_set(settings_for(tmp_path, chunks, images="png"), store)
    first, withdrawn, last = manifests(tmp_path)
    new = {"samples": 1, "why": "new clip"}
    assert first["came"] == dict.fromkeys(("kitchen", "procedural_0", "procedural_1"), new)
    assert withdrawn["went"] == {"procedural_1": {"samples": 1, "why": "withdrawn"}}
    assert withdrawn["came"] == withdrawn["changed"] == {} and withdrawn["why"] == ["went: 1 clip"]
    assert last["went"] == {"kitchen": {"samples": 1, "why": "source gone"}}
    changed = {"samples": 1, "why": "another digest; settings changed: images"}
    assert last["changed"] == {"procedural_0": changed} and "procedural_1" in last["came"]
    for name, digest in last["shards"].items():
        assert file_sha256(tmp_path / "set" / name) == digest
    (tmp_path / "afresh").mkdir()
    make_set(settings_for(tmp_path / "afresh", chunks, kitchen, shard_mb=5), store)
    (cut,) = manifests(tmp_path / "afresh")
    assert cut["digest"] == first["digest"] and cut["shards"] != first["shards"]


def test_croissant_metadata_are_valid_and_describe_the_files(output, tmp_path):
    mlcroissant = pytest.importorskip("mlcroissant")
    _, store, settings, _ = output
    make_set(settings_for(tmp_path, *settings.sources, licences={"kitchen": "CC0-1.0"}), store)
    described = mlcroissant.Dataset(jsonld=tmp_path / "set/croissant.json")
    assert not described.metadata.ctx.issues.errors
    rows = pq.read_table(tmp_path / "set/index.parquet").to_pylist()
    records = [
        {
            name.removeprefix("samples/"): value.decode() if isinstance(value, bytes) else value
            for name, value in record.items()
        }
        for record in described.records("samples")
    ]
    assert records == rows
    assert {row["clip"]: row["licence"] for row in rows}["kitchen"] == "CC0-1.0"
    assert described.metadata.license == ["CC0-1.0", "unknown"]
    files = {file.name: file.sha256 for file in described.metadata.distribution}
    assert files == {name: file_sha256(tmp_path / "set" / name) for name in files}
    assert set(files) == {"index.parquet", *(row["shard"] for row in rows)}
    assert "| kitchen | CC0-1.0 | 1 |" in card(tmp_path)
    assert "licence of `chunks` is unknown" in card(tmp_path)
    with pytest.raises(InputError, match=r"licences: found 'kitchn'.*did you mean"):
        make_set(settings_for(tmp_path, *settings.sources, licences={"kitchn": "MIT"}), store)


def test_purge_removes_a_clip_from_store_set_and_chunks(output, tmp_path, slg):
    folder, _, settings, _ = output
    for name in ("set", "store", "chunks"):
        shutil.copytree(folder / name, tmp_path / name)
    store = ArtifactStore(tmp_path / "store")
    models = Versions(tmp_path / "models")
    for clip in ("procedural_1", "procedural_0"):
        models.add(clip[-1:].encode(), {"learnt_clips": [mark_clip(clip)]}, False, "a test")
    models.add(b"later", {"learnt_clips": []}, False, "a test", models.version(1))
    places = [tmp_path / name for name in ("set", "chunks")]
    command = ["store", "purge", "--store", store.root, "--models", models.folder]
    command += [word for place in places for word in ("--set", place)]
    before = files_below(tmp_path)
    status, listing, _ = slg(*command, "--place", "https://video/1")
    assert status == 0 and "nothing was removed" in listing
    assert files_below(tmp_path) == before and "  example/" in listing
    weights = [line for line in listing.splitlines() if line.startswith(f"{models.folder}: v")]
    assert [line.partition(": ")[2] for line in weights] == [
        "version 1 was trained on them",
        "version 3 was trained on them",
    ]
    (tmp_path / "set/notes.txt").write_text("look at procedural_1 again, not at procedural_10")
    status, out, _ = slg(*command, "--clip", "procedural_1", "--yes")
    assert status == 1 and [line for line in out.splitlines() if line.startswith("  ")] == [
        f"  {tmp_path}/set/notes.txt"
    ]
    (tmp_path / "set/notes.txt").unlink()
    assert slg(*command, "--clip", "procedural_1")[0] == 0
    # Independently of the command: no text, and no picture of the clip, in any file.
    (clip,) = re10k.read_chunk(folder / "chunks/000001.torch")
    scenes = {str(store.get(ref)["scene"]) for ref in find_refs(store, "sample")}
    assert {name[:-10] for name in scenes} >= {"kitchen", "procedural_0"}
    assert not [name for name in scenes if name.startswith("procedural_1_")]
    for spec in ("sample", "gaussians", "bank", "example"):
        assert len(find_refs(store, spec)) < len(find_refs(ArtifactStore(folder / "store"), spec))
    for name, data in files_below(tmp_path).items():
        assert b"procedural_1" not in data and not any(image in data for image in clip.images), name
    rows = TrainingSet(tmp_path / "set").rows.to_pylist()
    assert {row["clip"] for row in rows} == {"kitchen", "procedural_0"}
    last = manifests(tmp_path)[-1]
    assert last["went"] == {"(withdrawn)": {"samples": 1, "why": "withdrawn"}}
    assert list(re10k.read_index(tmp_path / "chunks")) == ["procedural_0"]
    # What others need is still there: nothing of them is computed again.
    kept = {file.uri for files in store.walk(["keys"]) for file in files}
    make_set(settings_for(tmp_path, tmp_path / "chunks", settings.sources[1]), store)
    assert kept <= {file.uri for files in store.walk(["keys"]) for file in files}


def find_refs(store: ArtifactStore, spec: str) -> list:
    return [parse_uri(file.uri) for files in store.walk([spec]) for file in files]


def test_dataset_leaves_out_bad_scenes_only(output, tmp_path):
    _, store, settings, _ = output
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "transforms.json").write_text("{")
    subset = write_folder(room(4, 2), tmp_path / "few")
    message = make_set(settings_for(tmp_path, *settings.sources, bad, subset), store)
    assert message.samples == 3
    rows = pq.read_table(tmp_path / "set/failures.parquet").to_pylist()
    reason = {row["scene"]: row["reason"] for row in rows}
    assert set(reason) == {"bad", "few"} and "transforms.json" in reason["bad"]
    assert "too few for a sample" in reason["few"]
    card = " ".join((tmp_path / "set/README.md").read_text().split())
    assert "# 3 samples of 3 places" in card and "| test | 3 | 3 | 3 |" in card
    assert "2 frames, clips and samples were refused;" in card
    assert str(tmp_path) not in card
    with pytest.raises(InputError, match="no sample is left of the sources; the reasons are in"):
        make_set(settings_for(tmp_path / "none", bad), store)
    assert pq.read_table(tmp_path / "none/set/failures.parquet")["scene"].to_pylist() == ["bad"]


def test_training_set_refuses_damaged_or_missing_files_in_one_sentence(
    output, tmp_path, monkeypatch
):
    folder, *_ = output
    with pytest.raises(SpecError, match=r"index\.parquet: cannot be read"):
        TrainingSet(tmp_path)
    with pytest.raises(InputError, match="split: found 'val', expected one of train, test"):
        TrainingSet(folder / "set", "val")
    with pytest.raises(InputError, match="has no sample that was asked for"):
        TrainingSet(folder / "set", where=pc.field("overlap") > 2)
    shutil.copytree(folder / "set", tmp_path / "set")
    samples = TrainingSet(tmp_path / "set")
    shard = tmp_path / "set" / samples.rows["shard"][0].as_py()
    members = samples.members(0)
    without = {name: data for name, data in members.items() if not name.startswith("context_1")}
    with monkeypatch.context() as patch:
        for changed in (without, {**members, "about.json": b"[]"}):
            patch.setattr(samples, "members", lambda index, changed=changed: changed)
            with pytest.raises(SpecError, match="is damaged"):
                samples[0]
    shard.write_bytes(b"x" * shard.stat().st_size)
    with pytest.raises(SpecError, match=f"{shard.name}: is damaged"):
        samples[0]
    shard.unlink()
    with pytest.raises(SpecError, match=f"{shard.name}: cannot be read"):
        samples[0]
