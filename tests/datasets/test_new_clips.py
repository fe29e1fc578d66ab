"""What came, changed and went: by content, damage apart from withdrawal."""

import pyarrow as pa

from slgaussian.datasets.new_clips import changes, clips_of, contents
from slgaussian.storage.specs import load_spec


def views(clips: dict[str, int], moved: float = 0.0, digest: str = "a") -> pa.Table:
    """So many views of each clip, whose chunk is the first letter of its key."""
    spec = load_spec("views").schema
    rows = []
    for clip, count in clips.items():
        for frame in range(count):
            row = {field.name: 0.0 if field.type == pa.float64() else 1 for field in spec}
            row |= {"chunk": f"{clip[0]}.torch", "clip": clip, "frame": frame, "w2c_03": moved}
            rows.append({**row, "digest": f"{digest}{frame}", "depth": None})
    return pa.Table.from_pylist(rows, schema=spec)


def test_a_clip_is_its_photographs_and_cameras_in_order():
    made = clips_of(views({"b1": 3, "a1": 2}))
    load_spec("clips").check_table(made, "clips")
    assert made["clip"].to_pylist() == ["a1", "b1"] and made["views"].to_pylist() == [2, 3]
    assert made["chunk"].to_pylist() == ["a.torch", "b.torch"]
    shuffled = views({"b1": 3, "a1": 2}).take([4, 2, 0, 3, 1])
    assert clips_of(shuffled).equals(made)
    others = [views({"a1": 2}, moved=1e-9), views({"a1": 2}, digest="b"), views({"a1": 3})]
    found = {contents(clips_of(table))["a1"] for table in [views({"a1": 2}), *others]}
    assert len(found) == 4
    assert clips_of(views({})).num_rows == 0


def test_what_is_gone_with_its_chunk_was_not_withdrawn():
    before = clips_of(views({"a1": 2, "a2": 2, "b1": 2, "c1": 2, "d1": 2}))
    now = pa.concat_tables([clips_of(views({"c1": 3, "d1": 2})), clips_of(views({"e1": 2}))])
    found = changes(before, now, {"b.torch", "a2"})
    assert found.arrived == ("e1",) and found.changed == ("c1",)
    assert found.withdrawn == ("a1",) and found.damaged == ("a2", "b1")
    nothing = changes(now, now, {"e1"})
    assert not any(vars(nothing).values())
