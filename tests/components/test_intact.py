"""Models equal those of the hub or can be loaded; anything else is refused in one sentence."""

import hashlib
import shutil

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from slgaussian.components.pretrained import WEIGHTS, check_component
from slgaussian.components.registry import find_config
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


def check(name, place) -> str:
    return check_component(find_config(KINDS[name], name)(model=place))


def refuse(name, place) -> str:
    with pytest.raises(InputError) as error:
        check(name, place)
    assert str(place) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("name", KINDS)
def test_model_of_unknown_origin_is_loaded_and_must_be_finite_and_whole(name, copy):
    place = copy(name)
    assert check(name, place) == f"model {place}: can be loaded"
    tensors = load_file(place / WEIGHTS)
    key = max(tensors, key=lambda key: tensors[key].size)
    tensors[key].flat[0] = np.nan
    save_file(tensors, place / WEIGHTS)
    assert "holds NaN or infinity; get it again" in refuse(name, place)
    save_file({k: tensors[k] for k in tensors if k != key}, place / WEIGHTS)
    assert "lacks " in refuse(name, place)


def test_damaged_or_missing_weights_are_refused_by_name(copy):
    place = copy("sam")
    file = place / WEIGHTS
    file.write_bytes(file.read_bytes()[:-100])
    refuse("sam", place)
    file.unlink()
    assert f"has no {WEIGHTS}" in refuse("sam", place)


def test_file_in_hub_cache_is_checked_by_its_sha256(copy):
    place = copy("sam")
    content = (place / WEIGHTS).read_bytes()
    blob = place.parent / hashlib.sha256(content).hexdigest()
    blob.write_bytes(content)
    (place / WEIGHTS).unlink()
    (place / WEIGHTS).symlink_to(blob)
    assert check("sam", place) == f"model {place}: is what the hub has, by its SHA-256"
    blob.write_bytes(content[:-4] + b"oops")
    message = refuse("sam", place)
    assert "is damaged: its SHA-256 begins with" in message and f"delete {blob}" in message


def test_check_downloads_no_model():
    with pytest.raises(InputError, match="`hf download no-such-owner/no-such-model`"):
        check("clip", "no-such-owner/no-such-model")
