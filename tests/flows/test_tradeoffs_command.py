"""`slgaussian tradeoffs`: one's own photographs, one held out, with every setting of the sweep."""

import json

import pyarrow.parquet as pq
import pytest
from command import ROOM, room, run, said
from PIL import Image

from flows import sweep, tradeoffs
from flows.cli.own_scene import held_out, own_scene
from flows.runners.commands import perform
from flows.settings import make_settings
from flows.sweep import Variant, variants
from flows.tradeoff_settings import make_tradeoff_settings
from slgaussian.errors import InputError
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import ArtifactStore

FEW = (
    Variant("size", "at most 208x288", {"size": "at most 208x288"}),
    Variant("size", "48x48", {"size": "48x48"}),
    Variant("codes", "exact", {"codes": "exact"}),
    Variant("codes", "nearest", {"grid": {"decode": "nearest"}}),
)
"""A size that the photographs do not reach, two changes, and a setting of a part not chosen."""


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Three photographs of a small room, with their cameras."""
    folder = tmp_path_factory.mktemp("photographs")
    scene, frames = room(), []
    for name, camera in scene.cameras.items():
        Image.fromarray(scene.read(name).image).save(folder / f"{name}.png")
        matrix = camera.c2w.copy()
        matrix[:, 1:3] *= -1
        frames.append({"file_path": f"{name}.png", "transform_matrix": matrix.tolist()})
    known = {"fl_x": camera.K[0, 0], "fl_y": camera.K[1, 1], "cx": camera.K[0, 2]}
    known |= {"cy": camera.K[1, 2], "w": camera.width, "h": camera.height, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(known))
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory, photographs, server):
    """The sweep of a room with true ids, by few settings."""
    folder = tmp_path_factory.mktemp("sweep")
    scene = {**ROOM, "options": {**ROOM["options"], "height": 64, "width": 64}}
    values = {"scenes": [{**scene, "near": 0.8, "far": 12.0}], "replicas": 1, "out": folder / "out"}
    values |= {"store": str(folder / "store"), "seeds": 1, "seconds": 1e6}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep, "_changes", lambda: iter(FEW))
        settings = make_tradeoff_settings(values)
        return settings, tradeoffs.run(settings, ArtifactStore(settings.store))


def test_a_row_is_a_setting_and_a_scene_and_what_is_the_same_has_one(made):
    settings, swept = made
    table = pq.read_table(settings.out / "tradeoffs.parquet")
    load_spec("tradeoffs").check_table(table, "tradeoffs.parquet")
    rows = table.to_pylist()
    assert [(row["factor"], row["setting"], row["height"]) for row in rows] == [
        ("as given", "as given", 64),
        ("size", "48x48", 48),
        ("codes", "exact", 64),
        ("seed", "1", 64),
    ]
    assert [row["options"] for row in rows] == [
        "--replicas 1",
        "--replicas 1 --size 48x48",
        "--replicas 1 --codes exact",
        "--replicas 1 --seed 1",
    ]
    for row in rows:
        assert row["iou"] is not None and row["psnr"] > 5 and 0 < row["kept"] <= row["gaussians"]
        assert row["query_seconds"] > 0 and row["field_seconds"] > 0
    assert rows[0]["agreement"] == 1 > rows[1]["agreement"] > 0
    assert not swept.failures and swept.proposal.chosen is not None
    content = json.loads((settings.out / "tradeoffs.json").read_text())
    assert content["proposed_options"] == swept.proposal.chosen.options
    assert "Proposed" in swept.page.read_text()


def test_only_what_a_changed_setting_touches_is_computed(made, monkeypatch):
    """The same sweep with another bank: what comes before the bank is found in the store."""
    settings, _ = made
    monkeypatch.setattr(sweep, "_changes", lambda: iter(FEW[2:3]))
    given = {**settings.given, "bank": "objects"}
    again = settings.model_copy(
        update={"given": given, "seeds": 0, "out": settings.out.parent / "again"}
    )
    perform("tradeoffs", again)
    log = (again.out / "log.jsonl").read_text().splitlines()
    done = {line["stage"] for line in map(json.loads, log) if line["event"] == "finished"}
    assert done == {"supervision", "field", "benchmark", "agreement"}


def test_every_variant_has_options_that_make_it():
    rows = variants({"replicas": 2}, 2)
    assert rows[0][0].options == "--replicas 2" and len(rows) > 15
    assert len({one.options for one, _ in rows}) == len(rows)
    for one, settings in rows:
        assert make_settings(dict(one.values), "test").identity == settings.identity


def test_what_is_given_already_is_no_row_of_its_own():
    names = {f"{one.factor}, {one.name}" for one, _ in variants({"codes": "exact"}, 0)}
    assert "codes, exact" not in names and "codes, grid" in names


def test_what_does_not_go_with_what_is_given_is_left_out(monkeypatch):
    monkeypatch.setattr(sweep, "_changes", lambda: iter(FEW))
    names = [one.name for one, _ in variants({}, 0)]
    assert names == ["as given", "at most 208x288", "48x48", "exact"]


@pytest.mark.parametrize(
    ("names", "middle", "context", "targets"),
    [
        ("ab", False, "ab", ""),
        ("abc", False, "ab", "c"),
        ("abc", True, "ac", "b"),
        ("abcd", True, "abd", "c"),
    ],
)
def test_which_photograph_is_held_out(names, middle, context, targets):
    assert held_out(names, middle) == (list(context), list(targets))


def test_a_scene_of_photographs_names_no_others_of_their_folder(photographs):
    names = [str(photographs / f"view_0{k}.png") for k in (0, 2, 1)]
    scene, told = own_scene(names, None)
    assert scene.options == {"only": ["view_00.png", "view_02.png", "view_01.png"]}
    assert (scene.context, scene.targets) == (["view_00.png", "view_02.png"], ["view_01.png"])
    assert "view_01.png is held out" in told
    scene, told = own_scene(names[:2], photographs)
    assert (scene.format, scene.targets) == ("nerfstudio", []) and "none is held out" in told
    scene, _ = own_scene([str(photographs)], photographs)
    assert (scene.context, scene.targets) == (["view_00.png", "view_02.png"], ["view_01.png"])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "found nothing to weigh settings on; give photographs, --data with"),
        (("--cameras", "t.json"), "--cameras: is given without photographs"),
        (("--rooms", "0", "--error", "2"), "error: found 2.0; input should be less than 1"),
        (
            ("--rooms", "0", "--seconds", "-1"),
            "seconds: found -1.0; input should be greater than 0",
        ),
        (("missing_a.png", "missing_b.png"), "missing_a.png: is no file; give photographs"),
        (("--rooms", "0", "--size", "no"), "size: found 'no'"),
    ],
)
def test_bad_input_is_said_in_a_sentence(monkeypatch, capsys, tmp_path, words, sentence):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "tradeoffs", *words) == 2
    assert sentence in said(capsys)
    assert not list(tmp_path.glob("slg-tradeoffs/*.html"))


def test_two_photographs_are_judged_by_how_far_settings_agree(
    monkeypatch, capsys, tmp_path, photographs, server
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sweep, "_changes", lambda: iter(FEW[1:2]))
    two = [photographs / "view_00.png", photographs / "view_02.png"]
    cameras = "--cameras", photographs, "--near", "0.8", "--far", "12", "--replicas", "1"
    assert run(monkeypatch, "tradeoffs", *two, *cameras, "--seeds", "0") == 0
    printed = capsys.readouterr()
    assert "none is held out" in printed.err and "error by change" in printed.out
    assert "options: --near 0.8 --far 12.0 --replicas 1" in printed.out
    assert (tmp_path / "slg-tradeoffs" / "tradeoffs.html").is_file()
    with pytest.raises(InputError, match="names must be unique"):
        make_tradeoff_settings({"scenes": [ROOM, ROOM]})


@pytest.mark.usefixtures("server")
def test_if_no_scene_goes_through_its_reason_is_said(monkeypatch, capsys, tmp_path, photographs):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sweep, "_changes", lambda: iter(()))
    blank = Image.new("RGB", (64, 64), (90, 90, 90))
    for name in ("a.png", "b.png"):
        blank.save(tmp_path / name)
    (tmp_path / "a.png").write_bytes((photographs / "view_00.png").read_bytes())
    assert run(monkeypatch, "tradeoffs", "a.png", "b.png", "--seeds", "0") == 2
    assert "no scene went through; the first because" in capsys.readouterr().err
