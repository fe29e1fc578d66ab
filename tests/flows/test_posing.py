"""Photographs without cameras on the command line: estimation, output, storage, reading."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command import ROOM, room, save_photographs
from PIL import Image

from slgaussian import datasets
from slgaussian.cameras.estimated import DOUBTFUL, EstimatedCameras, EstimatedPair, Focal
from slgaussian.cameras.quality import Quality
from slgaussian.datasets import unposed
from slgaussian.datasets.recognise import cameras_in
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.scene import Estimated
from tests.datasets.taken_photographs import stereo_pair

SIZE = 96, 128
PHOTOS = [f"{name}.png" for name in ROOM["context"]]
ELSEWHERE = "elsewhere.png"
"""A photograph that the made-up finder cannot place."""

SAID = Estimated((0.9, 1.15), "matches", 0.42)


def truth(photographs) -> EstimatedCameras:
    """Return the room's cameras as estimates, in the frame of the first."""
    valid = room(*SIZE).cameras
    names = [photograph.name for photograph in photographs if photograph.name != ELSEWHERE]
    left_out = {p.name: "of another place" for p in photographs if p.name == ELSEWHERE}
    cameras = {n: replace(valid[n.removesuffix(".png")], estimated=SAID) for n in names}
    to_first = cameras[names[0]].w2c
    unit = np.linalg.norm(cameras[names[1]].center - cameras[names[0]].center)
    for name, camera in cameras.items():
        c2w = to_first @ camera.c2w
        c2w[:3, 3] /= unit
        cameras[name] = replace(camera, c2w=c2w, near=None, far=None)
    f = float(cameras[names[0]].K[0, 0])
    pair = EstimatedPair((names[0], names[1]), 90, 60, float("nan"), 2.5, DOUBTFUL, "few matches")
    return EstimatedCameras(
        cameras,
        dict.fromkeys(names, Focal(f, 0.9 * f, 1.15 * f, "matches")),
        (pair,),
        0.42,
        "few matches",
        ("the poses may be off by some degrees; take a third photograph",),
        left_out,
    )


@pytest.fixture
def photos(tmp_path, monkeypatch):
    """Write two photographs without cameras to the current folder."""
    save_photographs(tmp_path, *SIZE)
    (tmp_path / "transforms.json").unlink()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(unposed, "find_cameras", truth)
    unposed._find.cache_clear()
    yield tmp_path
    unposed._find.cache_clear()


def test_field_reports_the_estimation_of_its_cameras(photos, slg):
    status, _, output = slg("field", *PHOTOS, "-o", "field")
    lines = [line for line in output.splitlines() if "compiling kernels" not in line]
    assert status == 0 and len(lines) <= 9
    assert "warning: the poses may be off by some degrees" in output
    assert "from matches); of two photographs, 60 of 90 matches agree" in output
    field = SemanticField.load("field")
    first, second = field.cameras.values()
    np.testing.assert_allclose(first.c2w, np.eye(4), atol=1e-12)
    assert np.linalg.norm(second.center) == pytest.approx(1)
    confidence = Quality(**field.settings["quality"]).camera_confidence(0.42)
    assert first.estimated.source == "matches"
    assert first.estimated.confidence == pytest.approx(confidence, abs=1e-4)
    info = field.settings["cameras"]
    assert info["confidence"] == pytest.approx(confidence, abs=1e-3) and confidence > 0.42
    assert f"right with a probability of {confidence:.0%}: few matches" in output


def test_cameras_writes_the_estimated_cameras(photos, slg, refusal):
    out = "there/transforms.json"
    status, printed, errors = slg("cameras", *PHOTOS, "-o", out)
    assert status == 0 and "cameras found: " in errors
    assert "60" in printed and "doubtful: few matches" in printed
    result = unposed.find(unposed.name_files(PHOTOS))
    valid = cameras_in(photos / out)
    assert len(valid) == 2
    for mine, alternative in zip(result.cameras.values(), valid.values(), strict=True):
        np.testing.assert_allclose(mine.K, alternative.K, atol=1e-9)
        np.testing.assert_allclose(mine.c2w, alternative.c2w, atol=1e-9)
        assert alternative.estimated == mine.estimated
    assert slg("cameras", *PHOTOS, "-o", out)[0] == 0  # its own are replaced
    assert slg("masks", *PHOTOS, "--cameras", out, "-o", "ids")[0] == 0
    error = refusal("cameras", *PHOTOS, "-o", "there")
    assert "error: there: exists and is no COLMAP model as" in error


@pytest.mark.whole
def test_field_of_cameras_from_colmap_is_that_of_transforms_json(tmp_path, slg):
    photos = [tmp_path / "a.png", tmp_path / "b.png"]
    for file, pixels in zip(photos, stereo_pair(), strict=True):
        Image.fromarray(pixels).save(file)
    fields = []
    for out in (tmp_path / "sparse/0", tmp_path / "transforms.json"):
        status, printed, _ = slg("cameras", *photos, "-o", out)
        assert status == 0 and printed.splitlines()[-1] == str(out)
        assert slg("field", *photos, "--cameras", out, "-o", f"{out}-field")[0] == 0
        fields.append(SemanticField.load(f"{out}-field"))
    colmap, nerfstudio = (field.gaussians.to_arrays() for field in fields)
    for name, values in colmap.items():
        np.testing.assert_allclose(values, nerfstudio[name], atol=1e-9, err_msg=name)
    assert fields[0].settings["cameras"] == fields[1].settings["cameras"]


def test_commands_leave_out_a_photograph_without_camera(photos, slg):
    all_three = [PHOTOS[0], ELSEWHERE, PHOTOS[1]]
    Image.fromarray(np.zeros((*SIZE, 3), np.uint8)).save(ELSEWHERE)
    status, _, errors = slg("field", *all_three, "-o", "field")
    assert status == 0 and "cameras found of 2 of 3 photographs: " in errors
    field = SemanticField.load("field")
    assert list(field.cameras) == PHOTOS
    assert field.settings["cameras"]["left_out"] == {ELSEWHERE: "of another place"}

    status, out, _ = slg("cameras", *all_three, "-o", "there/t.json", "--json")
    assert status == 0 and json.loads(out)["left_out"] == {ELSEWHERE: "of another place"}
    content = json.loads((photos / "there/t.json").read_text())
    assert [frame["file_path"] for frame in content["frames"]] == [f"../{n}" for n in PHOTOS]
    assert content["slgaussian"]["left_out"] == {f"../{ELSEWHERE}": "of another place"}
    status, _, errors = slg("masks", *all_three, "--cameras", "there/t.json", "-o", "ids")
    warned = f"warning: {ELSEWHERE} has no camera, as it could not be estimated, and is left out"
    assert status == 0 and warned in errors
    valid = datasets.load("nerfstudio", photos / "there/t.json")
    with pytest.raises(InputError, match=r"was left out when cameras were found \(of another"):
        valid.sample([PHOTOS[0], ELSEWHERE])


def test_commands_refuse_bad_photographs_before_any_work(photos, monkeypatch, refusal):
    monkeypatch.setattr(unposed, "find_cameras", lambda photographs: pytest.fail("worked"))
    (photos / "mine.json").write_text('{"frames": []}')
    for words, error in [
        (("cameras", *PHOTOS, "-o", "mine.json"), "mine.json: exists and was not written"),
        (("cameras", *PHOTOS, "-o", "a.json", "--format", "colmap"), "expected no suffix, as of"),
        (("cameras", *PHOTOS, "--format", "llff"), "format: found 'llff' without a file"),
        (("cameras", PHOTOS[0]), "expected at least two"),
        (("field", "a.jpg", "b.jpg"), "a.jpg: cannot be read (No such file"),
    ]:
        assert error in refusal(*words)
    assert (photos / "mine.json").read_text() == '{"frames": []}'
