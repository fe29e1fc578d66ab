"""Split by place: assignments stay, joined places are on one side, leaks are refused."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image
from test_scene_grouping import picture, view

from slgaussian.datasets.leaks import check_shards
from slgaussian.datasets.scene_grouping import Places
from slgaussian.datasets.shards import END_OF_ARCHIVE, pack
from slgaussian.datasets.splits import assign_split, read_split
from slgaussian.errors import InputError


def assign(folder: Path, clips: dict[str, np.ndarray], winner: str = "test", share: float = 0.2):
    """Assign clips of one photograph each, after what the folder has recorded, and record it."""
    places = Places()
    places.add_views(view(clip, clip, grey) for clip, grey in clips.items())
    split = assign_split(places, clips, share, read_split(folder), winner)
    split.write(folder)
    return split


def test_assign_split_never_moves_a_place_as_the_corpus_grows(tmp_path):
    clips = {f"place{k}": picture(k) for k in (0, 1, 3, 5)}
    before = assign(tmp_path, clips).sides
    assert "test" in before.values()  # one is held out, though the hash of none says so
    for k in (2, 4, *range(6, 30)):
        clips[f"place{k}"] = picture(k)
        split = assign(tmp_path, clips, share=0.2 if k < 20 else 0.9)
        assert before.items() <= split.sides.items()
        before = split.sides
    assert split.new == 1 and {"train", "test"} == set(before.values())
    assert "clips: 30, new 1, alone 30, left out 0" in split.summary


@pytest.mark.parametrize("winner", ["test", "train"])
def test_assign_split_leaves_out_one_side_of_joined_places(tmp_path, winner):
    greys = {f"clip{k}": picture(k) for k in range(8)}
    sides = assign(tmp_path, greys, winner, 0.5).sides
    learnt = min(clip for clip, side in sides.items() if side == "train")
    judged = min(clip for clip, side in sides.items() if side == "test")
    places = Places()
    places.add_views(view(clip, clip, grey) for clip, grey in greys.items())
    places.add_views([view("both", learnt), view("both", judged)])
    split = assign_split(places, {*greys, "both"}, 0.5, read_split(tmp_path), winner)
    gone, stays = (learnt, judged) if winner == "test" else (judged, learnt)
    assert split.left_out.keys() == {gone} and gone not in split.sides
    assert f"shows one place with {stays!r}, which was assigned to {winner}" in split.left_out[gone]
    assert split.sides[stays] == split.sides["both"] == winner
    assert f"left out 1, as {split.left_out[gone]}" in split.summary
    split.write(tmp_path)

    # The clip that told it is gone: what is known stays known.
    after = assign(tmp_path, greys, winner, 0.5)
    assert after.left_out.keys() == {gone} and after.sides == {c: sides[c] for c in after.sides}
    row = next(row for row in read_split(tmp_path) if row["clip"] == gone)
    assert (row["why"], row["split"]) == ("recorded", sides[gone])


def write_set(folder: Path, pictures: dict[str, bytes]) -> pa.Table:
    """Write a shard of each split; the keys are ``SPLIT/SAMPLE``."""
    rows = []
    for split in ("train", "test"):
        data, shard = b"", f"{split}-000000.tar"
        for name, image in pictures.items():
            if name.startswith(split):
                sample = name.partition("/")[2]
                part = pack(sample, {"context_0.jpg": image})
                row = {"clip": sample, "sample": sample, "shard": shard, "offset": len(data)}
                rows.append({**row, "bytes": len(part)})
                data += part
        (folder / shard).write_bytes(data + END_OF_ARCHIVE)
    return pa.Table.from_pylist(rows)


def jpeg(pixels: np.ndarray, quality: int = 95) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG", quality=quality)
    return out.getvalue()


def test_check_shards_refuses_pictures_on_both_sides(tmp_path):
    rng = np.random.default_rng(0)
    first, second = (
        np.kron(rng.integers(0, 255, (9, 12, 3)), np.ones((20, 20, 1))).astype(np.uint8)
        for _ in range(2)
    )
    clean = {"train/a": jpeg(first), "test/b": jpeg(second)}
    check_shards(tmp_path, write_set(tmp_path, clean), ())
    for copy, how in (
        (jpeg(first), "are equal byte for byte"),
        (jpeg(first, 60), "are near copies, so"),
        (jpeg(first[5:-4, 6:-6]), "are near copies"),
    ):
        index = write_set(tmp_path, {**clean, "test/c": copy})
        with pytest.raises(InputError, match=f"(a|c).context_0.jpg .*{how}.*the split leaks"):
            check_shards(tmp_path, index, ["test-000000.tar"])
        assert not (tmp_path / "test-000000.tar").exists()
        assert (tmp_path / "train-000000.tar").exists()
