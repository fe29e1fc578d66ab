"""Models equal those of the hub or can be loaded; anything else is refused in one sentence."""

import hashlib
import shutil

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from slgaussian.components.intact import check_component
from slgaussian.components.pretrained import WEIGHTS
from slgaussian.errors import InputError

pytest.importorskip("transformers")

from tests.language.small_clip import save_clip
from tests.masks.small_models import save_sam, save_sam2

pytestmark = pytest.mark.usefixtures("one_thread")

KINDS = {"clip": "encoder", "sam": "proposer", "sam2": "proposer"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("models")
    saved = {"clip": save_clip, "sam": save_sam, "sam2": save_sam2}
    return {name: save(root / name) for name, save in saved.items()}


@pytest.fixture
def copy(folders, tmp_path):
    return lambda name: shutil.copytree(folders[name], tmp_path / name)


def refused(name, place) -> str:
    with pytest.raises(InputError) as error:
        check_component(KINDS[name], name, {"model": place})
    assert str(place) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("name", KINDS)
def test_a_model_that_nobody_knows_is_loaded_and_tried(name, copy):
    place = copy(name)
    message = check_component(KINDS[name], name, {"model": place})
    assert message == f"model {place}: can be loaded"
    tensors = load_file(place / WEIGHTS)
    key = max(tensors, key=lambda key: tensors[key].size)
    tensors[key].flat[0] = np.nan
    save_file(tensors, place / WEIGHTS)
    assert "holds NaN or infinity; get it again" in refused(name, place)
    save_file({k: tensors[k] for k in tensors if k != key}, place / WEIGHTS)
    assert "lacks " in refused(name, place)


def test_damaged_and_missing_weights_are_named(copy):
    place = copy("sam")
    file = place / WEIGHTS
    file.write_bytes(file.read_bytes()[:-100])
    refused("sam", place)
    file.unlink()
    assert f"has no {WEIGHTS}" in refused("sam", place)


@pytest.mark.parametrize(("model", "name"), [("sam", "clip"), ("clip", "sam"), ("sam2", "sam")])
def test_a_model_of_another_kind_is_refused(folders, model, name):
    refused(name, folders[model])


def test_a_file_of_the_hub_is_known_by_its_digest(copy):
    place = copy("sam")
    content = (place / WEIGHTS).read_bytes()
    blob = place.parent / hashlib.sha256(content).hexdigest()
    blob.write_bytes(content)
    (place / WEIGHTS).unlink()
    (place / WEIGHTS).symlink_to(blob)
    verdict = check_component("proposer", "sam", {"model": place})
    assert verdict == f"model {place}: is what the hub has, by its SHA-256"
    blob.write_bytes(content[:-4] + b"oops")
    message = refused("sam", place)
    assert "is damaged: its SHA-256 begins with" in message and f"delete {blob}" in message


def test_a_name_that_is_not_here_is_not_downloaded():
    with pytest.raises(InputError, match="`hf download no-such-owner/no-such-model`"):
        check_component("encoder", "clip", {"model": "no-such-owner/no-such-model"})
