"""Training: learning, reproducible bytes despite interruptions, and refusals."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from drawn_lessons import lesson
from train_and_die import LESSONS, SETTINGS

from slgaussian.errors import InputError
from slgaussian.semantic.branch import Architecture, make_branch, save_branch
from slgaussian.semantic.checkpoints import CHECKPOINT
from slgaussian.semantic.training import compute_loss, draw_batch, train
from slgaussian.storage.specs import load_spec
from tests.kernel_threads import kernels_on

ROOT = Path(__file__).parents[2]


def bytes_in(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


@pytest.fixture(autouse=True, scope="module")
def _alone():
    """Use one thread: these images are too small to share work."""
    with kernels_on(1):
        yield


@pytest.fixture(scope="module")
def full_training(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    train(LESSONS, SETTINGS, folder)
    return folder


def test_train_lowers_the_loss(tmp_path):
    settings = SETTINGS.model_copy(update={"steps": 36, "every": 36, "rate": 1e-2})
    trained = train(LESSONS, settings, tmp_path)
    load_spec("metrics").check_table(trained.metrics, "metrics")
    losses = trained.metrics["loss"].to_numpy()
    # Measured with four seeds: 0.43 to 0.48.
    assert losses[-12:].mean() < 0.6 * losses[:12].mean(), (losses[-12:].mean(), losses[:12].mean())
    assert trained.metrics["step"].to_pylist() == [*range(1, 37)]
    samples = trained.metrics["sample"].to_pylist()
    assert all(set(samples[i : i + 3]) == {f"wall {k}" for k in range(3)} for i in range(0, 36, 3))
    assert len({tuple(samples[i : i + 3]) for i in range(0, 36, 3)}) > 1


@pytest.mark.parametrize("step", [2, 7])
def test_train_resumes_to_the_same_bytes_after_a_kill(tmp_path, full_training, step):
    script = Path(__file__).with_name("train_and_die.py")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (script.parent, ROOT)))}
    killed = subprocess.run([sys.executable, script, tmp_path, str(step)], env=env, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert (tmp_path / CHECKPOINT).is_file() == (step >= SETTINGS.every)
    steps = []
    train(LESSONS, SETTINGS, tmp_path, progress=lambda p: steps.append(p.step))
    assert steps[0] == step // SETTINGS.every * SETTINGS.every + 1
    assert bytes_in(tmp_path) == bytes_in(full_training)


def test_train_gives_equal_bytes_on_any_number_of_threads(tmp_path, full_training):
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            folder = tmp_path / str(threads)
            with kernels_on(threads):
                train(LESSONS, SETTINGS, folder)
            assert torch.get_num_threads() == threads
            assert bytes_in(folder) == bytes_in(full_training)
    finally:
        torch.set_num_threads(before)


def test_train_averages_a_batch(tmp_path):
    """One step of a batch of all lessons is one along the mean of the gradients of each."""
    settings = SETTINGS.model_copy(update={"steps": 1, "batch": len(LESSONS), "every": 1})
    branch = make_branch(settings.architecture, 4)
    losses = []
    for drawn in draw_batch(LESSONS, settings, 0):
        losses.append(compute_loss(branch, drawn.lesson, drawn.views, settings.codes, drawn.rng))
    gradients = torch.autograd.grad(sum(losses) / len(losses), list(branch.parameters()))
    length = torch.cat([gradient.ravel() for gradient in gradients]).norm()
    trained = train(LESSONS, settings, tmp_path, branch)
    (row,) = trained.metrics.to_pylist()
    assert row["loss"] == pytest.approx(float(sum(losses).detach()) / len(losses), rel=1e-6)
    assert row["norm"] == pytest.approx(float(length), rel=1e-5)
    assert sorted(row["sample"].split(", ")) == [f"wall {k}" for k in range(3)]


def test_train_starts_from_given_weights(tmp_path):
    start = make_branch(SETTINGS.architecture, 9)
    settings = SETTINGS.model_copy(update={"steps": 1, "rate": 1e-12})
    trained = train(LESSONS, settings, tmp_path / "a", start)
    for name, weights in start.state_dict().items():
        torch.testing.assert_close(trained.branch.state_dict()[name], weights)
    other = make_branch(Architecture(widths=(4, 6), hidden=8))
    with pytest.raises(InputError, match=r"widths=\(4, 6\).*choose that architecture"):
        train(LESSONS, settings, tmp_path / "b", other)


@pytest.mark.parametrize(
    ("lessons", "change", "start", "sentence"),
    [
        (LESSONS, {"rate": 0.1}, None, r"another training \(rate 0.003 instead of 0.1\)"),
        (LESSONS, {"architecture": Architecture((4,), 8)}, None, "architecture .* instead of"),
        (LESSONS[:2], {}, None, "lessons 3 instead of 2"),
        (LESSONS, {}, make_branch(SETTINGS.architecture, 9), "start"),
        ([], {}, None, "found no lessons"),
        (LESSONS, {"device": "gpu0"}, None, "training device: found 'gpu0'"),
        (LESSONS, {"device": "cuda:99"}, None, "training device: found 'cuda:99'"),
        (LESSONS, {"device": ""}, None, "training device: found ''"),
    ],
)
def test_train_refuses_unusable_input(full_training, lessons, change, start, sentence):
    before = bytes_in(full_training)
    with pytest.raises(InputError, match=sentence):
        train(lessons, SETTINGS.model_copy(update=change), full_training, start)
    assert bytes_in(full_training) == before
    with pytest.raises(InputError, match="cannot be made"):
        train(LESSONS, SETTINGS, full_training / CHECKPOINT / "under")


def test_train_refuses_damaged_checkpoints(tmp_path, full_training):
    state = torch.load(full_training / CHECKPOINT)
    moments = {**state["optimiser"], "state": {0: {"exp_avg": torch.zeros(5)}}}
    for damaged in ({"run": 1}, {"branch": {}}, {"optimiser": moments}, {"metrics": b""}):
        torch.save({**state, **damaged}, tmp_path / CHECKPOINT)
        with pytest.raises(InputError, match=f"{CHECKPOINT}: is damaged"):
            train(LESSONS, SETTINGS, tmp_path)
    (tmp_path / CHECKPOINT).write_bytes(save_branch(make_branch(SETTINGS.architecture)))
    with pytest.raises(InputError, match=f"{CHECKPOINT}: is damaged"):
        train(LESSONS, SETTINGS, tmp_path)


def test_train_stops_at_an_infinite_loss_and_names_the_sample(tmp_path):
    bad = lesson(7)
    start = make_branch(SETTINGS.architecture)
    start.first.weight.data[0] = torch.nan
    with pytest.raises(InputError, match=r"step 1: sample 'wall \d' gives a loss of nan"):
        train([bad], SETTINGS, tmp_path, start)
    assert not list(tmp_path.iterdir())


def test_train_ignores_a_lesson_without_objects(tmp_path):
    mine = lesson()
    nothing = replace(mine, labels=np.zeros_like(mine.labels), targets=np.zeros_like(mine.targets))
    trained = train([nothing], SETTINGS, tmp_path)
    assert trained.metrics["loss"].to_pylist() == [0.0] * SETTINGS.steps
