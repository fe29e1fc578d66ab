"""`slgaussian doctor --models`: what is here, what it is, and what is wrong with it."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("transformers")

import torch
from command import run
from safetensors.torch import load_file, save_file

from flows.cli import model_checks
from flows.cli.model_checks import Request, examine_models, looked_at
from flows.runners import child
from slgaussian.parts.pretrained import WEIGHTS, model_digest
from tests.language.small_clip import save_clip
from tests.masks.small_models import save_sam, save_sam2

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("models")
    saved = {"clip": save_clip, "sam": save_sam, "sam2": save_sam2}
    return {name: save(root / name) for name, save in saved.items()}


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache of the hub, and no way to the hub."""
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    return tmp_path / "hub"


def download(folder, cache, name: str) -> None:
    """Put a folder into the cache as the hub's own client does."""
    place = cache / f"models--{name.replace('/', '--')}"
    (place / "refs").mkdir(parents=True)
    (place / "refs" / "main").write_text("0" * 40)
    shutil.copytree(folder, place / "snapshots" / ("0" * 40))


def about(place, part=None, **settings) -> Request:
    return Request(str(place), str(place), part, settings, None)


def wrong(request: Request) -> str:
    """The one thing that is wrong with a model that cannot be used."""
    *fine, last = looked_at(request)
    assert last.good is False and not any(finding.good is False for finding in fine)
    assert "\n" not in last.said and "Traceback" not in last.said
    return last.said


@pytest.mark.whole
def test_models_are_told_and_fail_for_a_stated_reason(folders, monkeypatch, capfd):
    """In programs of their own, as users have it."""
    assert run(monkeypatch, "doctor", "--models", *folders.values()) == 1
    told = capfd.readouterr()
    assert "Traceback" not in told.err + told.out
    lines = [line.split(maxsplit=2) for line in told.out.splitlines()]
    kinds = {part: [line for line in lines if line[1] == part] for part in folders}
    first = {part: found[0][2] for part, found in kinds.items()}
    assert first["clip"].startswith(f"{folders['clip']}: CLIP of 24 axes: images of 32 pixels by 2")
    assert first["sam"].startswith(f"{folders['sam']}: SAM: images of 64 pixels by 2 layers of 16")
    assert first["sam2"].startswith(f"{folders['sam2']}: SAM 2: images of 64 pixels by 1+1+2+1 ")
    for part, found in kinds.items():
        said = "\n".join(line[2] for line in found)
        assert f"known to fields as {model_digest(folders[part])}" in said
        assert "model.safetensors: whole, SHA-256 " in said
        assert " s an image" in said and "GiB of memory at the peak" in said
        bad = [line[2] for line in found if line[0] == "BAD"]
        assert bad and all("random or damaged?" in line for line in bad)


def test_the_cache_of_the_hub_is_looked_through(folders, cache, monkeypatch):
    """Without network; what else it holds is said and left."""
    asked = []
    monkeypatch.setattr(
        model_checks, "_looked_at_elsewhere", lambda request: asked.append(request) or iter(())
    )
    (found,) = examine_models([], {})
    assert found.good is None and "`hf download NAME`" in found.said and not asked
    download(folders["sam"], cache, "someone/small-sam")
    download(folders["clip"], cache, "someone/small-clip")
    other = cache.parent / "bert"
    other.mkdir()
    (other / "config.json").write_text('{"model_type": "bert"}')
    download(other, cache, "someone/bert")
    (cache / "models--no--body").mkdir()
    (found,) = examine_models([], {"clip": {"precision": "bfloat16"}})
    assert found.good is None and found.said.endswith("no CLIP, SAM or SAM 2: someone/bert")
    assert [request.called for request in asked] == ["someone/small-clip", "someone/small-sam"]
    assert all(model_checks.kind_of(request.place) for request in asked)
    assert asked[0].settings["precision"] == "bfloat16"
    broken = cache / "models--someone--small-sam" / "snapshots" / ("0" * 40) / "config.json"
    broken.write_text("{")
    said = [finding.said for finding in examine_models([], {}) if finding.good is False]
    assert len(said) == 1 and "someone/small-sam" in said[0] and "read as JSON" in said[0]


def test_options_name_what_a_model_must_be(folders, monkeypatch):
    asked = []
    monkeypatch.setattr(
        model_checks, "_looked_at_elsewhere", lambda request: asked.append(request) or iter(())
    )
    given = {"encoder": "clip", "clip": {"model": str(folders["sam"])}, "proposer": "sam"}
    found = list(examine_models([], given | {"named": {"table": "names.npz"}}))
    assert [f.said for f in found] == ["its model is not given; give --sam-model PLACE"]
    (request,) = asked
    assert (request.part, request.table) == ("clip", "names.npz")
    said = wrong(request)
    assert f"{folders['sam']}: is a model of SAM, given as CLIP; give it as --sam-model" in said


@pytest.mark.parametrize(
    ("model", "part", "says"),
    [
        ("sam", "clip", "is a model of SAM, given as CLIP"),
        ("clip", "sam", "is a model of CLIP, given as SAM"),
        ("clip", "sam2", "is a model of CLIP, given as SAM 2"),
        ("sam2", "sam", "is a model of SAM 2, given as SAM;"),
    ],
)
def test_swapped_models_are_named(folders, model, part, says):
    assert f"{folders[model]}: {says}" in wrong(about(folders[model], part))


@pytest.fixture
def copy(folders, tmp_path):
    return lambda part: shutil.copytree(folders[part], tmp_path / part)


@pytest.mark.parametrize("part", ["clip", "sam", "sam2"])
def test_truncated_and_swapped_weights_are_named(part, copy, folders):
    place = copy(part)
    file = place / WEIGHTS
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert f"{file}: is cut short: found " in wrong(about(place))
    other = "clip" if part == "sam" else "sam"
    shutil.copy(folders[other] / WEIGHTS, file)
    assert f"{place}: lacks " in wrong(about(place))
    file.unlink()
    assert f"{place}: has no {WEIGHTS}" in wrong(about(place))


def test_damaged_weights_are_named(copy):
    place = copy("clip")
    file = place / WEIGHTS
    tensors = load_file(file)
    name = "vision_model.encoder.layers.0.mlp.fc1.weight"
    save_file({**tensors, name: torch.full_like(tensors[name], float("nan"))}, file)
    assert f"{name} holds NaN or infinity" in wrong(about(place))
    save_file({**tensors, name: torch.zeros_like(tensors[name])}, file)
    (found,) = (f for f in looked_at(about(place)) if f.said.startswith("weights: "))
    assert found.good is False and f"{name} zero all over, 3.6 % of all; was it" in found.said
    (place / "config.json").write_text("no")
    assert "config.json: cannot be read as JSON" in wrong(about(place))


def test_checkpoints_and_other_things(folders, tmp_path, copy):
    damaged = tmp_path / "open_clip_pytorch_model.bin"
    damaged.write_bytes(b"PK\3\4 and then nothing")
    assert f"{damaged}: cannot be read as weights" in wrong(about(damaged))
    said = wrong(about(tmp_path / "none"))
    assert said == f"{tmp_path / 'none'}: there is no such file or folder; correct its name"
    (tmp_path / "empty").mkdir()
    assert "is no model of CLIP, SAM, SAM 2; give the" in wrong(about(tmp_path / "empty"))
    place = copy("clip")
    for file in ("vocab.json", "merges.txt", "tokenizer.json", "tokenizer_config.json"):
        (place / file).unlink(missing_ok=True)
    assert "has no tokenizer beside it" in wrong(about(place))
    found = list(looked_at(about(place, tokenizer=str(folders["clip"]))))
    assert found[0].good is True


def test_a_name_that_is_not_here_is_not_downloaded(cache):
    said = wrong(about("someone/small-clip"))
    assert "not in the cache of the hub yet" in said and "hf download someone/small-clip" in said


def test_a_table_of_text_vectors_is_compared(folders, tmp_path):
    table = tmp_path / "names.npz"
    np.savez(table, names=np.array(["cat", "dog"]), features=np.eye(2, 24))
    request = Request(str(folders["clip"]), "here", None, {}, str(table))
    (found,) = (f for f in looked_at(request) if f.said.startswith("table"))
    assert found.good is None and "is of another model" in found.said


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("import os; os.kill(os.getpid(), 9)", "was ended by SIGKILL; it may need more memory"),
        ("raise SystemExit('no such thing')", "failed (no such thing)"),
    ],
)
def test_a_program_that_dies_is_a_finding(folders, monkeypatch, code, says):
    """As one that the system ends for its memory: what it had said before stands."""
    line = json.dumps({"name": "sam", "said": "begun", "good": True})
    words = [sys.executable, "-c", f"print({line!r}, flush=True); {code}"]
    monkeypatch.setattr(child, "begin", lambda *_, **options: subprocess.Popen(words, **options))
    first, last = model_checks._looked_at_elsewhere(about(folders["sam"]))
    assert first.said == "begun"
    assert last.good is False and last.name == "sam" and says in last.said


def test_a_place_is_for_models(monkeypatch, capsys):
    assert run(monkeypatch, "doctor", "models/clip") == 2
    assert "found 'models/clip', which is for --models" in capsys.readouterr().err
