"""`--encoder auto` takes CLIP where its weights are, says so, and downloads nothing."""

import shutil

import pytest

pytest.importorskip("transformers")

from command import room_sample, run, save_photographs, settings
from huggingface_hub import constants, snapshot_download

from flows.read_config import make_settings, read_toml
from slgaussian.build import build_field
from slgaussian.components.pretrained import WEIGHTS, model_digest
from slgaussian.field import SemanticField
from slgaussian.language.clip import Clip
from tests.language.small_clip import save_clip
from tests.masks.small_models import save_sam

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return save_clip(tmp_path_factory.mktemp("models") / "clip")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """An empty cache of the hub; whoever asks the hub for more than that fails the test."""
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))

    def never(name, *words, local_files_only=False, **rest):
        assert local_files_only, f"{name} would be downloaded"
        return snapshot_download(name, *words, local_files_only=True, **rest)

    monkeypatch.setattr("huggingface_hub.snapshot_download", never)
    return tmp_path / "hub"


def download(folder, cache, name: str):
    place = cache / f"models--{name.replace('/', '--')}"
    (place / "refs").mkdir(parents=True)
    (place / "refs" / "main").write_text("0" * 40)
    return shutil.copytree(folder, place / "snapshots" / ("0" * 40))


def chosen(capsys, **values) -> tuple[str, str]:
    """The encoder that is taken, and what is said of it."""
    settings = make_settings({"encoder": "auto", **values}, "test")
    return settings.encoder, capsys.readouterr().err


def test_without_weights_it_is_the_lexicon(capsys):
    encoder, output = chosen(capsys)
    assert encoder == "lexicon"
    assert output == (
        "encoder auto: lexicon, as no CLIP is on this machine "
        f"(`hf download {Clip.FAMILY.example}` brings one)\n"
    )


def test_the_default_model_in_the_cache_is_taken(model, cache, capsys):
    folder = download(model, cache, Clip.FAMILY.example)
    download(model, cache, "someone/other-clip")
    encoder, output = chosen(capsys)
    assert encoder == "clip"
    assert output == f"encoder auto: clip, as {Clip.FAMILY.example} is on this machine\n"
    (folder / "merges.txt").unlink()
    (folder / "tokenizer.json").unlink(missing_ok=True)
    encoder, output = chosen(capsys)
    assert encoder == "clip" and "someone/other-clip is the one CLIP in the hub's cache" in output


def test_one_other_model_in_the_cache_is_taken_and_of_several_none(model, cache, tmp_path, capsys):
    download(save_sam(tmp_path / "sam"), cache, "someone/small-sam")
    folder = download(model, cache, "someone/small-clip")
    settings = make_settings({"encoder": "auto"}, "test")
    assert settings.encoder == "clip" and settings.clip.model == "someone/small-clip"
    capsys.readouterr()
    download(model, cache, "someone/other-clip")
    encoder, output = chosen(capsys)
    assert encoder == "lexicon"
    assert "several of CLIP (someone/other-clip, someone/small-clip); name one" in output
    (folder / WEIGHTS).unlink()
    assert chosen(capsys)[0] == "clip"


def test_a_model_that_is_given_is_taken_or_missed(model, tmp_path, capsys):
    encoder, output = chosen(capsys, clip={"model": str(model), "crops": "context"})
    assert encoder == "clip" and f"as {model} is on this machine" in output
    for place in (tmp_path / "none", save_sam(tmp_path / "sam"), "no-such/clip"):
        encoder, output = chosen(capsys, clip={"model": str(place)})
        assert encoder == "lexicon"
        assert f"as {place} is no whole CLIP with its tokenizer on this machine" in output
    local = {"model": str(model), "tokenizer": "no-such/words"}
    assert chosen(capsys, clip=local)[0] == "lexicon"


def test_what_is_built_knows_what_was_taken(model, tmp_path, monkeypatch, capsys):
    """By a command, and by a configuration file: never `auto`, and the same as if it was named."""
    save_photographs(tmp_path)
    words = ["field", *sorted(tmp_path.glob("*.png")), "--cameras", tmp_path, "--encoder", "auto"]
    words += settings(near=0.8, far=12, replicas=1, **{"clip.model": model})
    assert run(monkeypatch, *words, "-o", tmp_path / "field") == 0
    assert capsys.readouterr().err.startswith(f"encoder auto: clip, as {model} is on this machine")
    valid = SemanticField.load(tmp_path / "field").settings
    assert valid["encoder"] == "clip" and valid["clip"]["model"] == model_digest(model)

    config = tmp_path / "run.toml"
    config.write_text(f'encoder = "auto"\n[clip]\nmodel = "{model}"\n')
    picked = read_toml(config, {})
    config.write_text(f'encoder = "clip"\n[clip]\nmodel = "{model}"\n')
    assert picked.identity == read_toml(config, {}).identity
    assert build_field(room_sample(), picked.built_by).settings["encoder"] == "clip"
