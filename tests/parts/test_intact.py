"""Files of weights that are cut short, too long, damaged or not those of the hub."""

import hashlib

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from slgaussian.errors import InputError
from slgaussian.parts.intact import check_numbers, check_whole, zero_matrices


@pytest.fixture
def file(tmp_path):
    place = tmp_path / "model.safetensors"
    save_file({"a": np.arange(64, dtype=np.float32), "b": np.ones((3, 3))}, place)
    return place


def test_a_whole_file_is_known_by_its_digest(file):
    assert check_whole(file) == hashlib.sha256(file.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("damaged", "says"),
    [
        (lambda whole: whole[:-1], r"is cut short: found 4\d\d bytes, expected 4\d\d; get it"),
        (lambda whole: whole + b"\0", "is too long"),
        (lambda whole: whole[:40], "is cut short within its header, at 40 bytes"),
        (lambda whole: whole[:3], "is cut short within its header, at 3 bytes"),
        (lambda whole: b"", "is damaged, or no safetensors file"),
        (lambda whole: b"version https://git-lfs.github.com/spec/v1\n" * 3, "no safetensors file"),
        (lambda whole: whole.replace(b"data_offsets", b"data_offsats"), "no safetensors file"),
        (lambda whole: whole[:8] + b"x" + whole[9:], "no safetensors file"),
    ],
)
def test_what_is_not_whole_is_named(file, damaged, says):
    file.write_bytes(damaged(file.read_bytes()))
    with pytest.raises(InputError, match=says) as error:
        check_whole(file)
    assert str(file) in str(error.value) and "\n" not in str(error.value)


def test_a_file_of_the_hub_is_held_against_its_name(file):
    content = file.read_bytes()
    blob = file.parent / "blobs" / hashlib.sha256(content).hexdigest()
    blob.parent.mkdir()
    blob.write_bytes(content)
    file.unlink()
    file.symlink_to(blob)
    assert check_whole(file) == blob.name
    blob.write_bytes(content[:-4] + b"oops")
    with pytest.raises(InputError, match="is damaged: its SHA-256 begins with") as error:
        check_whole(file)
    assert f"delete {blob}" in str(error.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none\.bin: cannot be read"):
        check_whole(tmp_path / "none.bin")


def test_weights_must_be_numbers_and_zero_matrices_are_listed():
    network = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.Linear(2, 2))
    check_numbers(network, "m")
    with torch.no_grad():
        network[1].bias.zero_()  # which an untouched bias may well be
    assert zero_matrices(network) == ([], 0)
    with torch.no_grad():
        network[1].weight.zero_()
    assert zero_matrices(network) == (["1.weight"], 4 / 14)
    with torch.no_grad():
        network[0].bias[1] = float("nan")
    with pytest.raises(InputError, match=r"model m: 0\.bias holds NaN"):
        check_numbers(network, "m")
