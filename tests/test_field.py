"""The field on a scene with an exact truth: a red and a blue half of one wall."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.build import build_field
from slgaussian.components.method import Method
from slgaussian.errors import InputError, SpecError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import save_ply
from slgaussian.gaussians import Gaussians, rgb_to_sh
from slgaussian.labels import LabelMaps
from slgaussian.scene import Camera, Estimated, Sample, View
from tests.known import known_field

H, W, FOCAL, DEPTH = 48, 64, 60.0, 3.0
RED, BLUE = (200, 30, 30), (30, 40, 190)


def camera(x: float) -> Camera:
    K = np.array([[FOCAL, 0, W / 2], [0, FOCAL, H / 2], [0, 0, 1]])
    c2w = np.eye(4)
    c2w[0, 3] = x
    return Camera(K, c2w, W, H)


def wall(cam: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Colours and labels of the wall z = DEPTH, red (5) where x < 0 and blue (9) elsewhere."""
    labels = np.where(cam.unproject(np.full((H, W), DEPTH))[..., 0] < 0, 5, 9).astype(np.int32)
    return np.where(labels[..., None] == 5, RED, BLUE).astype(np.uint8), labels


@pytest.fixture(scope="module")
def field() -> SemanticField:
    cameras = [camera(-0.2), camera(0.2)]
    walls = [wall(cam) for cam in cameras]
    views = [
        View(name, cam, image) for name, cam, (image, _) in zip("ab", cameras, walls, strict=True)
    ]
    sample = Sample("wall", tuple(views))
    labels = np.stack([labels for _, labels in walls])
    labels[0, :4, :4] = 0
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    points = np.concatenate([c.unproject(np.full((H, W), DEPTH)).reshape(-1, 3) for c in cameras])
    colours = np.concatenate([image.reshape(-1, 3) for image, _ in walls]) / 255
    n = len(points)
    gaussians = Gaussians(
        means=torch.tensor(points, dtype=torch.float32),
        scales=torch.full((n, 3), 0.6 * DEPTH / FOCAL),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        opacities=torch.full((n,), 0.95),
        sh=rgb_to_sh(torch.tensor(colours, dtype=torch.float32)),
        source=torch.arange(n, dtype=torch.int32),
    )
    return known_field(sample, gaussians, label_maps, Method(codes="grid", keep="all"))


def test_a_new_view_shows_the_right_colours_ids_and_depth(field):
    cam = camera(0.05)
    image, labels = wall(cam)
    seen = field.render(cam)
    # Within two pixels of the border between the two, light is mixed.
    inner = np.s_[2:-2, 3:-3]
    border = np.abs(np.arange(W) + 0.5 - W / 2 + 0.05 * FOCAL / DEPTH) < 2.5
    away = np.broadcast_to(~border, (H, W))[inner]
    assert (seen.ids[inner] == labels[inner])[away].all()
    assert np.abs(seen.rgb[inner].astype(int) - image[inner])[away].max() <= 2
    assert np.abs(seen.depth[inner] - DEPTH).max() < 1e-3


def test_words_find_their_half(field):
    cam = camera(0.05)
    _, labels = wall(cam)
    seen = field.render(cam)
    for text, label in (("red", 5), ("blue wall", 9)):
        hit = seen.query(text)
        overlap = (hit.mask & (labels == label)).sum() / (hit.mask | (labels == label)).sum()
        assert overlap > 0.9
        assert labels[hit.point[1], hit.point[0]] == label
        assert hit.objects[0][0] == label


def test_segment_gives_every_half_its_word(field):
    _, labels = wall(field.cameras["a"])
    named = field.render(field.cameras["a"]).segment(["blue", "red"])
    assert (named == np.where(labels == 5, 2, 1))[5:, 2:-2].mean() > 0.97


def test_arguments_of_the_wrong_type_are_refused(field, tmp_path):
    view = field.render(field.cameras["a"])
    for call, message in [
        (lambda: field.render("a.jpg"), "render: expected a Camera.*found a str"),
        (lambda: view.query(["red", "blue"]), "query: expected one text.*found a list"),
        (lambda: build_field(["a.jpg", "b.jpg"]), "build_field: expected a Sample.*found a list"),
        (lambda: save_ply(str(tmp_path / "x.ply"), field.gaussians), "save_ply: expected Gauss"),
    ]:
        with pytest.raises(InputError, match=message):
            call()


def test_what_is_in_the_field(field):
    red, blue = field.describe(["blue", "red"])
    assert (red.id, red.text, red.views) == (5, "red", (0, 1))
    assert (blue.id, blue.text, blue.views) == (9, "blue", (0, 1))


def test_cameras_that_were_found_say_so_in_a_saved_field(field, tmp_path):
    said = Estimated((0.9, 1.2), "EXIF", 0.8)
    cameras = {**field.cameras, "a": replace(field.cameras["a"], estimated=said)}
    SemanticField(field.gaussians, field.bank, cameras, field.settings).save(tmp_path / "field")
    again = SemanticField.load(tmp_path / "field")
    assert [again.cameras[name].estimated for name in "ab"] == [said, None]
    file = tmp_path / "field/field.json"
    content = json.loads(file.read_text())
    assert "estimated" not in content["cameras"]["b"]
    content["cameras"]["a"]["estimated"]["confidence"] = 7
    file.write_text(json.dumps(content))
    with pytest.raises(SpecError, match=r"damaged .*estimated"):
        SemanticField.load(tmp_path / "field")


def test_saving_twice_gives_the_same_bytes(field, tmp_path):
    field.save(tmp_path / "one")
    field.save(tmp_path / "two")
    field.save(tmp_path / "two")
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()


@pytest.fixture(scope="module", params=["grid", "separated", "exact"])
def coded(request, field):
    """The field with codes of every strategy, in every dimension, and with none."""
    cameras = list(field.cameras.values())
    views = [View(name, cam, wall(cam)[0]) for name, cam in zip("ab", cameras, strict=True)]
    labels = np.stack([wall(cam)[1] for cam in cameras])
    label_maps = LabelMaps(labels, np.ones(labels.shape, np.float32))
    sample = Sample("wall", tuple(views))
    fields = []
    for dimension in (0,) if request.param == "exact" else (1, 2, 3):
        own = {request.param: {"dimension": dimension}} if dimension else {}
        plain = replace(field.gaussians, features=None)
        method = Method(codes=request.param, settings=own)
        fields.append(known_field(sample, plain, label_maps, method))
        assert fields[-1].bank.codes.shape == (2, dimension)
    return fields


def test_every_kind_of_code_says_the_same_and_keeps_it_on_disk(coded, tmp_path):
    """Two objects mix at one border only: no code can read a third there."""
    cam = camera(0.05)
    _, labels = wall(cam)
    border = np.abs(np.arange(W) + 0.5 - W / 2 + 0.05 * FOCAL / DEPTH) < 2.5
    for number, made in enumerate(coded):
        made.save(tmp_path / f"{number}")
        again = SemanticField.load(tmp_path / f"{number}")
        seen, loaded = made.render(cam), again.render(cam)
        assert seen.confidence.dtype == np.float32
        for name in ("rgb", "ids", "confidence", "alpha", "depth"):
            np.testing.assert_array_equal(getattr(seen, name), getattr(loaded, name))
        inner = np.s_[2:-2, 3:-3]
        away = np.broadcast_to(~border, (H, W))[inner]
        assert (seen.ids[inner] == labels[inner])[away].all()
        assert seen.confidence[inner][away].min() > 0.9
        assert seen.confidence[:, border].min() < 0.5
        np.testing.assert_array_equal(made.labels(), again.labels())
        assert set(np.unique(made.labels())) == {5, 9}
        table = again.objects()
        assert table.column("code_b").null_count == (0 if made.bank.dimension == 3 else 2)
        assert sum(table.column("gaussians").to_pylist()) == len(made.gaussians)
        assert seen.query("red").objects[0][0] == 5


def test_features_that_do_not_fit_the_bank_are_named(coded, tmp_path):
    made = coded[0]
    wrong = made.gaussians.features + 0.5 if made.bank.dimension == 0 else torch.zeros(1, 7)
    wrong = wrong.expand(len(made.gaussians), -1).contiguous()
    spoilt = replace(made.gaussians, features=wrong)
    field = SemanticField(spoilt, made.bank, made.cameras, made.settings)
    field.save(tmp_path / "field")
    with pytest.raises(SpecError, match=r"gaussians\.npz: .*features"):
        SemanticField.load(tmp_path / "field")


def test_a_folder_that_is_no_field_is_left_alone(field, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is not a field"):
        field.save(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_a_folder_under_a_file_cannot_be_written(field, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        field.save(tmp_path / "file" / "field")


@pytest.mark.parametrize("name", ["gaussians.npz", "bank.npz", "field.json"])
@pytest.mark.parametrize("damage", ["cut", "gone"])
def test_damage_is_named(field, tmp_path, name, damage):
    field.save(tmp_path / "field")
    file = tmp_path / "field" / name
    if damage == "gone":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(SpecError, match=name.replace(".", r"\.")):
        SemanticField.load(tmp_path / "field")


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"cameras": None}, "damaged"),
        ({"places": {"model": 3}}, "damaged .a place is no text"),
        ({"files": {"gaussians.npz": "../../etc"}}, "damaged"),
        ({"format": None}, "format: found none.*expected 1; build the field again"),
        ({"format": 9, "made_by": "slgaussian 9"}, "format: found 9, made by slgaussian 9, expect"),
    ],
)
def test_a_description_that_cannot_be_used_is_named(field, tmp_path, changed, sentence):
    field.save(tmp_path / "field")
    about = tmp_path / "field" / "field.json"
    about.write_text(json.dumps(json.loads(about.read_text()) | changed))
    with pytest.raises(SpecError, match=rf"field\.json: {sentence}"):
        SemanticField.load(tmp_path / "field")


def test_files_of_two_fields_are_not_mixed(field, tmp_path):
    field.save(tmp_path / "field")
    moved = replace(field.gaussians, means=field.gaussians.means + 1)
    replace(field, gaussians=moved).save(tmp_path / "other")
    shutil.copy(tmp_path / "other" / "gaussians.npz", tmp_path / "field")
    with pytest.raises(SpecError, match=r"gaussians\.npz: digest: .*of another field"):
        SemanticField.load(tmp_path / "field")


def test_a_folder_says_what_it_is(field, tmp_path):
    field.save(tmp_path / "field")
    about = json.loads((tmp_path / "field" / "field.json").read_text())
    assert about["format"] == 1 and about["made_by"].startswith("slgaussian ")
    assert about["settings"] == field.settings and list(about["cameras"]) == ["a", "b"]
    assert set(about["files"]) | {"field.json"} == {
        file.name for file in (tmp_path / "field").iterdir()
    }
