"""The identity of a file, folder or model changes with everything that is read from it."""

import os
import time
from pathlib import Path

import pytest

from slgaussian.components.pretrained import model_digest, tokenizer_digest
from slgaussian.io import file_digest
from slgaussian.masks.configs import folder_digest

MODEL = ("config.json", "model.safetensors", "preprocessor_config.json", "vocab.json", "merges.txt")


def write(file: Path, text: str) -> Path:
    """Write a file with an old modification time."""
    file.parent.mkdir(parents=True, exist_ok=True)
    time.sleep(0.02)  # more than a tick of the clock
    file.write_text(text)
    os.utime(file, (1e9, 1e9))
    return file


@pytest.mark.parametrize(
    ("digest", "names"),
    [
        (lambda folder: file_digest(folder / "a.npz"), ["a.npz"]),
        (folder_digest, ["a.png", "b.npy", "images/.hidden/a.png"]),
        (model_digest, MODEL),
        (tokenizer_digest, MODEL[3:]),
        (lambda folder: model_digest(folder / "b.pt"), ["b.pt", "open_clip_config.json"]),
    ],
    ids=["file", "maps", "model", "tokenizer", "checkpoint"],
)
def test_digest_changes_with_every_file_of_same_size_and_time(tmp_path, digest, names):
    for name in names:
        write(tmp_path / name, "one")
    digests = {digest(tmp_path)}
    for name in names:
        write(tmp_path / name, "two")
        digests |= {digest(tmp_path)}
        file = (tmp_path / name).rename(tmp_path / "elsewhere")
        (tmp_path / name).symlink_to(write(tmp_path / "six", "six"))
        digests |= {digest(tmp_path)}
        (tmp_path / name).unlink()
        file.rename(tmp_path / name)
    assert len(digests) == 1 + 2 * len(names)


@pytest.mark.parametrize("name", ["special_tokens_map.json", "added_tokens.json"])
def test_digest_changes_with_new_tokenizer_file_beside_model(tmp_path, name):
    for one in MODEL:
        write(tmp_path / one, "one")
    before = model_digest(tmp_path), tokenizer_digest(tmp_path)
    write(tmp_path / "README.md", "nothing")
    assert before == (model_digest(tmp_path), tokenizer_digest(tmp_path))
    write(tmp_path / name, "one")
    after = model_digest(tmp_path), tokenizer_digest(tmp_path)
    assert before[0] != after[0] and before[1] != after[1]


def test_folder_digest_follows_linked_folders(tmp_path):
    maps = tmp_path / "maps"
    for name in ("one", "two"):
        write(tmp_path / name / "a.png", name)
    digests = set()
    maps.mkdir()
    for name in ("one", "two"):
        (maps / "images").unlink(missing_ok=True)
        (maps / "images").symlink_to(tmp_path / name)
        digests |= {folder_digest(maps)}
    assert len(digests) == 2
