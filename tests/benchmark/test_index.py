import json

import pytest

from slgaussian.benchmark.index import Index, ScenePair, read_index, write_index
from slgaussian.errors import InputError


def write(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize("text", ["[]", "{}", '{"hall": 3}', "nonsense"])
def test_read_index_refuses_other_documents(tmp_path, text):
    with pytest.raises(InputError, match=r"pairs\.json"):
        read_index(write(tmp_path / "pairs.json", text))


PAIR = ScenePair(
    options={"scene": "ramen"},
    labels="label/ramen",
    context=("a.jpg", "c.jpg"),
    target=("b.jpg",),
    categories=("egg", "nori"),
    measured={"overlap": 0.8},
)
NAME = "ramen-frame_00024"
INDEX = Index(
    format="lerf_ovs",
    rule={"name": "around", "version": 1, "max_aside": 0.3},
    scenes={NAME: PAIR},
    left_out={"ramen-f": "no pair"},
)


def test_read_index_reads_all_versions(tmp_path):
    path = tmp_path / "pairs.json"
    write_index(path, INDEX)
    assert read_index(path) == INDEX
    first = path.read_bytes()
    write_index(path, read_index(path))
    assert path.read_bytes() == first
    fern = {"context": ["1.png", "3.png", "5.png"], "target": ["0.png", "4.png"]}
    write(path, {**json.loads(first), "scenes": {"fern": fern}})
    pair = ScenePair(context=("1.png", "3.png", "5.png"), target=("0.png", "4.png"))
    assert read_index(path).scenes == {"fern": pair}
    write(path, {"fern": {**fern, "categories": ["leaf"]}, "hall": {**fern, "categories": ["x"]}})
    old = read_index(path)
    assert list(old.scenes) == ["fern", "hall"] and old.format == ""
    write(path, {"fern": {**fern, "categories": None}})
    with pytest.raises(InputError, match="scene 'fern': categories is missing"):
        read_index(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 3}, "found version 3, expected at most 2"),
        ({"version": 1}, "found version 1, expected at most 2"),
        ({"format": None}, "format: found None;"),
        ({"target": ["a.jpg"]}, "'a.jpg' is both context and target"),
        ({"target": []}, "target: found [];"),
        ({"context": ["a", "a"]}, "context: found ['a', 'a']; expected different names"),
        ({"context": ["a"]}, "context: found ['a']; value should have at least 2 items"),
        ({"labels": "a/../b"}, "labels: found 'a/../b'; expected a folder below the labels"),
        ({"labels": "/etc"}, "labels: found '/etc'; expected a folder below the labels"),
        ({"categories": []}, "categories: found [];"),
    ],
)
def test_read_index_names_an_invalid_field(tmp_path, change, message):
    path = tmp_path / "pairs.json"
    write_index(path, INDEX)
    content = json.loads(path.read_text())
    of_file = change.keys() <= content.keys()
    (content if of_file else content["scenes"][NAME]).update(change)
    with pytest.raises(InputError) as caught:
        read_index(write(path, content))
    scene = "" if of_file else "scene 'ramen-frame_00024': "
    assert str(caught.value).startswith(f"{path}: {scene}")
    assert message in str(caught.value)


PUBLISHED = {"context": [58, 133], "target": [84, 102]}


def test_read_index_reads_clips_of_a_published_index(tmp_path):
    file = write(tmp_path / "index.json", {"ab": PUBLISHED, "cd": None})
    views = {"context": ("58", "133"), "target": ("84", "102")}
    pair = ScenePair(labels="ab", options={"key": "ab"}, **views)
    expected = Index(format="re10k", rule={}, scenes={"ab": pair}, left_out={})
    assert read_index(file) == expected
    # Targets that are contexts are left out.
    clips = {
        "ab": {"context": [34, 81], "target": [53, 81]},
        "cd": {"context": [1, 9], "target": [9, 1]},
    }
    index = read_index(write(file, clips))
    assert [pair.target for pair in index.scenes.values()] == [("53",)]
    assert sorted(index.left_out) == ["ab/81", "cd", "cd/1", "cd/9"]
    # A frame that is listed twice is one view.
    twice = {"context": [58, 58, 133], "target": [84, 102, 84]}
    assert read_index(write(file, {"ab": twice})) == expected
    for change in ({"context": [-1]}, {"target": ["a"]}):
        message = r"clip 'a': (context|target).0: found (-1|'a'); "
        with pytest.raises(InputError, match=message):
            read_index(write(file, {"a": PUBLISHED | change}))


def test_read_index_reads_the_published_file(real_data):
    index = read_index(real_data / "re10k" / "evaluation_index_re10k.json")
    assert len(index.scenes) == 6474
    assert len({name.split("/")[0] for name in index.left_out}) == 575
