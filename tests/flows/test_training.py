"""Training and retraining as flows: cached, resumed, refused, promoted only if better."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from command import files_below, run

from flows.config import RetrainSettings
from flows.read_config import read_toml
from flows.training import FILES
from slgaussian.datasets.splits import read_split
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.seeding import held_out
from slgaussian.scene import Camera
from slgaussian.semantic import load_lifting
from slgaussian.semantic.branch import Architecture, load_branch, make_branch, save_branch
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.versions import Versions
from slgaussian.storage.encoding import encode_table
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore

pytestmark = pytest.mark.usefixtures("server")

SIZE = (16, 20)
FEW = ("--steps", "4", "--set", "held_out=0.4")


def lesson(seed: int, holed: bool = False) -> Lesson:
    """Return a lesson: two views of a wall with two painted objects, and one between them.

    With ``holed``, rows of both views have no label: a lifting that learns to fill them beats those
    that copy labels.
    """
    wall = np.full(SIZE, 3.0)
    views = [camera(x) for x in (-0.2, 0.2, 0.0)]
    points = np.stack([view.unproject(wall) for view in views])
    labels = (1 + (points[..., 0] > 0.05 * (seed % 7 - 3))).astype(np.int32)
    if holed:
        labels[:2, 5:11] = 0
    n = 2 * SIZE[0] * SIZE[1]
    gaussians = Gaussians(
        means=torch.from_numpy(points[:2].reshape(-1, 3).astype(np.float32)),
        scales=torch.full((n, 3), 0.08),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        opacities=torch.full((n,), 0.8),
        sh=torch.zeros(n, 0, 3),
        source=torch.arange(n, dtype=torch.int32),
    )
    return Lesson(f"wall {seed}", gaussians, labels[:2], (views[2],), labels[2:])


def camera(x: float) -> Camera:
    c2w = np.eye(4)
    c2w[0, 3] = x
    K = np.array([[20.0, 0, SIZE[1] / 2], [0, 20.0, SIZE[0] / 2], [0, 0, 1]])
    return Camera(K, c2w, SIZE[1], SIZE[0])


def make_lessons(folder: Path, seeds, holed: bool = False) -> pa.Table:
    """Write lessons to the store of a folder, and their table to its ``corpus``."""
    store, rows = ArtifactStore(folder / "store"), []
    for seed in seeds:
        drawn = lesson(seed, holed)
        ref = store.put("lesson", drawn.to_arrays())
        row = {"chunk": f"{seed // 8}.torch", "sample": drawn.sample, "clip": drawn.sample}
        counts = {"gaussians": len(drawn.gaussians), "objects": 2, "shared": 2}
        shares = {"unlabelled_context": 0.0, "unlabelled_target": 0.0}
        rows.append({**row, "uri": ref.uri, "digest": ref.digest, **counts, **shares})
    table = pa.Table.from_pylist(rows, schema=load_spec("lessons").schema)
    out = folder / "corpus"
    out.mkdir(exist_ok=True)
    (out / "lessons.parquet").write_bytes(encode_table(table, load_spec("lessons")))
    write_views(out / "views.parquet", {clip: noise(clip) for clip in table["clip"].to_pylist()})
    return table


def noise(name: str) -> np.ndarray:
    return np.random.default_rng(list(name.encode())).integers(40, 200, 256).astype(np.uint8)


def write_views(file: Path, greys: dict[str, np.ndarray]) -> None:
    """Write a table of spec ``views`` with one photograph of every clip, by its signature."""
    schema, rows = load_spec("views").schema, []
    for number, (clip, grey) in enumerate(greys.items()):
        values = {f.name: 0 if pa.types.is_integer(f.type) else 0.5 for f in schema}
        values |= {"chunk": None, "clip": clip, "place": None, "video": "", "width": 8, "height": 8}
        values |= {"digest": f"{number:016x}" * 4, "signature": grey.tobytes().hex()}
        rows.append(values)
    table = pa.Table.from_pylist(rows, schema=schema)
    file.write_bytes(encode_table(table, load_spec("views")))


def command(folder: Path, out: str = "out", *more: str) -> list[str]:
    arguments = ["--lessons", folder / "corpus", "-o", folder / out, "--store", folder / "store"]
    return ["train", *map(str, arguments), *more]


def test_train_writes_all_files_and_reuses_results(tmp_path, slg):
    table = make_lessons(tmp_path, range(12))
    status, _, errors = slg(*command(tmp_path, "out", *FEW))
    assert status == 0 and "branch  train  cached" not in errors
    files = files_below(tmp_path / "out")
    assert files.keys() == {*FILES.values(), "places.parquet"}
    assert load_branch(tmp_path / "out" / "branch.safetensors").architecture == Architecture()
    for name in ("metrics", "judgements"):
        stored = pq.read_table(tmp_path / "out" / f"{name}.parquet")
        load_spec(name).check_table(stored, name)
    test_clips = {clip for clip in table["clip"].to_pylist() if held_out(clip, 0.4)}
    learnt = set(pq.read_table(tmp_path / "out" / "metrics.parquet")["sample"].to_pylist())
    judged = stored.to_pylist()
    assert (
        0 < len(test_clips) < 12
        and {row["clip"] for row in judged} == test_clips
        and not test_clips & learnt
    )
    one = [row["lifting"] for row in judged if row["sample"] == min(test_clips)]
    assert one == ["hard", "filled", "branch"]
    page = files["report.html"].decode()
    assert "http" not in page and page.count("data:image/svg+xml") == 1
    assert not list((tmp_path / "store" / "checkpoints").rglob("*.pt"))

    # Another order, and other chunks, are no other lessons.
    shuffled = table.take(np.arange(12)[::-1]).set_column(0, table.schema.field(0), [["x"] * 12])
    (tmp_path / "corpus" / "lessons.parquet").write_bytes(
        encode_table(shuffled, load_spec("lessons"))
    )
    assert "branch  train  cached" in slg(*command(tmp_path, "again", *FEW))[2]
    assert files_below(tmp_path / "again") == files


def test_train_command_resumes_to_the_same_bytes_after_a_kill(tmp_path, monkeypatch):
    for name in ("killed", "whole"):
        (tmp_path / name).mkdir()
        make_lessons(tmp_path / name, range(6))
    long = ("--steps", "44", "--set", "held_out=0.4")
    program = "import sys; from flows.cli.app import main; main()"
    argv = [sys.executable, "-c", program, *command(tmp_path / "killed", "out", *long)]
    root = str(Path(__file__).parents[2])
    process = subprocess.Popen(
        argv, cwd=root, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": root}
    )
    places = tmp_path / "killed" / "store" / "checkpoints"
    while not list(places.rglob("checkpoint.pt")):
        assert process.poll() is None, process.stderr.read().decode()
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (tmp_path / "killed" / "out" / "branch.safetensors").exists()
    steps = count_steps(monkeypatch)
    assert run(monkeypatch, *command(tmp_path / "killed", "out", *long)) == 0
    assert len(steps) in (4, 24)  # after the second checkpoint, or more likely the first
    assert run(monkeypatch, *command(tmp_path / "whole", "out", *long)) == 0
    assert files_below(tmp_path / "killed" / "out") == files_below(tmp_path / "whole" / "out")


def count_steps(monkeypatch) -> list[int]:
    from slgaussian.semantic import training

    steps, step = [], training._step

    def counted(*args):
        steps.append(args[-1])
        return step(*args)

    monkeypatch.setattr(training, "_step", counted)
    return steps


def test_train_command_refuses_unusable_input(tmp_path, monkeypatch, refusal):
    make_lessons(tmp_path, range(6))
    monkeypatch.chdir(tmp_path)
    for words, expected in (
        (("--store", "elsewhere"), "give the --store of `slgaussian supervise`"),
    ):
        assert expected in refusal(*command(tmp_path, "out", *words))


def retrain_settings(folder: Path, **more):
    values = {
        "sources": ["chunks"],
        "out": str(folder / "corpus"),
        "models": str(folder / "models"),
    }
    return read_toml(None, {**values, "held_out": 0.4, "steps": 4, **more}, RetrainSettings)


def bad_branch() -> bytes:
    branch = make_branch(Architecture(widths=(4, 8), hidden=8), seed=3)
    with torch.no_grad():
        branch.last.bias -= 1.0
    return save_branch(branch)


def test_retrain_promotes_better_weights_only(tmp_path):
    from flows.retraining import learn

    store, versions = ArtifactStore(tmp_path / "store"), Versions(tmp_path / "models")
    settings = retrain_settings(tmp_path)
    outcome = learn(make_lessons(tmp_path, range(16)), settings, store)
    assert (
        outcome.version.number == 1 and not outcome.version.promoted and versions.current() is None
    )
    why = r"version 1 stored, not promoted: (no gain over|worse than) no network \((filled|hard)\)"
    assert re.match(why, outcome.message)
    same = learn(make_lessons(tmp_path, range(16)), settings, store)
    assert same.version is None
    assert same.message == "nothing new since version 1; no version is in use"

    bad = versions.add(bad_branch(), {"asked": {"held_out": 0.4}}, True, "for the test")
    outcome = learn(make_lessons(tmp_path, range(18)), settings, store)
    assert not outcome.version.promoted
    assert re.match(
        r"version 3 stored, not promoted: (no gain over|worse than) no network", outcome.message
    )
    assert outcome.regressed.startswith("version 2, in use, is worse than no network (")

    settings = retrain_settings(tmp_path, steps=200, rate=0.02)
    outcome = learn(make_lessons(tmp_path, range(18), holed=True), settings, store)
    assert (
        outcome.version.promoted and outcome.version.parent == bad.number and not outcome.regressed
    )
    assert outcome.message.startswith("version 4 promoted: better than no network (")
    assert (
        outcome.message.endswith("and version 2") or "and than version 2 and no" in outcome.message
    )
    assert versions.current() == outcome.version
    scores = outcome.version.facts["scores"]["iou"]
    assert scores["branch"] > scores["before"]
    sides = {row["clip"]: row["split"] for row in read_split(tmp_path / "models")}
    learn(make_lessons(tmp_path, range(24)), retrain_settings(tmp_path, held_out=0.9), store)
    after = {row["clip"]: row["split"] for row in read_split(tmp_path / "models")}
    assert sides.items() <= after.items() and len(after) == 24
    assert outcome.version.split != versions.all()[-1].split
    assert load_lifting("branch", weights=tmp_path / "models").branch.architecture.hidden == 8
    (tmp_path / "models" / "places.parquet").unlink()
    with pytest.raises(InputError, match=r"no places\.parquet, expected .* version 4 has learnt"):
        learn(make_lessons(tmp_path, range(24)), settings, store)


def test_retrain_promotes_refuses_and_rolls_back(tmp_path, slg):
    """Lessons in which the branch can win; the second night trains too little to be better."""
    from flows.retraining import learn

    store, versions, nights = ArtifactStore(tmp_path / "store"), Versions(tmp_path / "models"), []
    for clips, steps in ((20, 30), (26, 2), (32, 200)):
        settings = retrain_settings(tmp_path, steps=steps, rate=0.02)
        night = learn(make_lessons(tmp_path, range(clips), holed=True), settings, store)
        nights.append(night.version)
    assert [night.promoted for night in nights] == [True, False, True]
    assert versions.current().number == 3
    sides = read_split(tmp_path / "models")
    assert len({row["clip"] for row in sides}) == len(sides) == 32
    status, _, _ = slg("versions", tmp_path / "models", "--use", "1")
    assert status == 0 and versions.current().number == 1
    for night in nights:  # shown by -rP
        print(night.number, night.facts["counts"], night.facts["scores"]["iou"], night.why)


def test_versions_command_lists_and_uses_versions(tmp_path, slg, refusal):
    versions = Versions(tmp_path / "models")
    for _ in range(2):
        versions.add(bad_branch(), {"asked": {"held_out": 0.4}}, False, "too few clips")
    versions.add(bad_branch(), {"split": "0123456789abcdef"}, False, "no gain")
    models = ["versions", tmp_path / "models"]
    status, out, _ = slg(*models, "--use", "2")
    listed = out.splitlines()
    assert status == 0 and listed[2].startswith("2 *  ")
    assert "  held     another split  too few clips" in listed[2]
    assert "  held  0123456789abcdef  no gain" in listed[3]
    assert listed[-1] == "* in use: version 2"
    for choice in ("7", "two"):
        error = refusal(*models, "--use", choice)
        assert "expected one of the versions there (1, 2, 3), or none" in error
    for choice, last in (("1", "* in use: version 1"), ("none", "none is in use")):
        assert slg(*models, "--use", choice)[1].splitlines()[-1] == last
