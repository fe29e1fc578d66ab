"""Index of a folder of labelled photographs, and the scenes of an index."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import skimage.data
from PIL import Image

from flows.config import IndexSettings, SceneSettings
from flows.indexing import build_index
from flows.read_config import make_settings
from flows.scene import baseline_tasks, scene_task
from flows.scenes import labelled_scenes, room_scene
from slgaussian.benchmark.index import Index, read_index
from slgaussian.datasets import re10k
from slgaussian.datasets.labelled_sets import PUBLISHED, is_published
from slgaussian.errors import InputError
from slgaussian.scene import Camera, Scene, View
from slgaussian.storage.store import ArtifactStore
from tasks.artifacts import sample_from_arrays, truth_from_arrays
from tasks.context import RunContext
from tasks.scene import ingest, truth
from tests.datasets.posed_folders import Shot, write_model

SIZE = (240, 160)
FRAMES = [f"frame_{i:05d}.jpg" for i in range(1, 10)]
SHOTS = {
    name: Shot(20 - i, place=(0.15 * i - 0.6, 0.02 * (i % 2), 0), turn=4 - i)
    for i, name in enumerate(FRAMES)
}
BOX = (60, 50, 140, 110)


@pytest.fixture(scope="module")
def room() -> Scene:
    """Render a photograph as a wall 3 m away from nine places along it."""
    wall = skimage.data.coffee()
    K = np.array([[200.0, 0, 120], [0, 200, 80], [0, 0, 1]])
    cameras = {}
    for i, shot in enumerate(SHOTS.values()):
        c2w = np.linalg.inv(np.vstack([shot.w2c(), (0, 0, 0, 1)]))
        cameras[str(i)] = Camera(K, c2w, *SIZE)

    def view(name: str) -> View:
        camera = cameras[name]
        scale = wall.shape[1] / 6  # the wall is 6 m wide
        to_wall = np.array([[1 / scale, 0, -3], [0, 1 / scale, -2], [0, 0, 3]])
        inside = camera.w2c[:3, :3] @ to_wall
        inside[:, 2] += camera.w2c[:3, 3]
        image = cv2.warpPerspective(wall, K @ inside, SIZE, borderMode=cv2.BORDER_REFLECT)
        return View(name, camera, image)

    return Scene("wall", cameras, view)


@pytest.fixture(scope="module")
def photographs(room) -> list[np.ndarray]:
    return [room.read(name).image for name in room.cameras]


@pytest.fixture
def lerf(tmp_path, photographs) -> Path:
    """Write it as the scenes ramen and teatime of a LERF-OVS folder, with some labels."""
    for scene in ("ramen", "teatime"):
        lens = {1: ("PINHOLE", (200, 200, 120, 80))}
        write_model(tmp_path / scene / "sparse/0", SHOTS, lens, size=SIZE)
        (tmp_path / scene / "images").mkdir()
        for name, image in zip(FRAMES, photographs, strict=True):
            Image.fromarray(image).save(tmp_path / scene / "images" / name, quality=95)
    label(tmp_path / "label/teatime", FRAMES[4])
    label(tmp_path / "label/teatime", FRAMES[0])  # the end of the path: nothing beyond it
    label(tmp_path / "label/ramen", FRAMES[3], "bowl", "nori")
    return tmp_path


def label(folder: Path, name: str, *categories: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    x0, y0, x1, y1 = BOX
    polygon = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    things = [
        {"category": category, "segmentation": polygon, "bbox": BOX}
        for category in categories or ("sheep",)
    ]
    info = {"name": name, "width": SIZE[0], "height": SIZE[1]}
    file = folder / f"{Path(name).stem}.json"
    file.write_text(json.dumps({"info": info, "objects": things}))


def index_scenes(data: Path, **values) -> Index:
    """The index that `benchmark` makes of data without one."""
    labels, rule = values.pop("labels", None), {"format": "lerf_ovs", **values}
    index = build_index(data, labels, IndexSettings(**rule), data / "pairs.json")
    assert index == read_index(data / "pairs.json")
    return index


class TestIndex:
    def test_every_labelled_frame_has_a_pair_or_a_reason(self, lerf):
        index = index_scenes(lerf)
        assert index.format == "lerf_ovs"
        assert index.rule["name"] == "around"
        assert list(index.scenes) == ["ramen-frame_00004", "teatime-frame_00005"]
        ramen, teatime = index.scenes.values()
        assert ramen.target == (FRAMES[3],)
        assert ramen.categories == ("bowl", "nori")
        assert (ramen.labels, ramen.options) == ("label/ramen", {"scene": "ramen"})
        before, after = (FRAMES.index(name) for name in teatime.context)
        assert 0 < before < 4 < after
        assert 0.6 <= teatime.measured["overlap"] <= 1
        assert "have it between them" in index.left_out["teatime-frame_00001"]

    def test_a_photograph_that_is_missing_or_damaged_is_no_context(self, lerf):
        pair = index_scenes(lerf).scenes["teatime-frame_00005"]
        (lerf / "teatime/images" / pair.context[0]).write_text("hello")
        (lerf / "teatime/images" / pair.context[1]).unlink()
        (lerf / "ramen/images" / FRAMES[3]).unlink()
        index = index_scenes(lerf)
        assert "no such photograph" in index.left_out["ramen-frame_00004"]
        assert not any(set(pair.context) & set(second.context) for second in index.scenes.values())

    def test_a_frame_with_an_empty_file_of_labels_is_neither_target_nor_context(self, lerf):
        pair = index_scenes(lerf).scenes["teatime-frame_00005"]
        for name in pair.context:
            label(lerf / "label/teatime", name)
            file = (lerf / "label/teatime" / name).with_suffix(".json")
            file.write_text(json.dumps({**json.loads(file.read_text()), "objects": []}))
        index = index_scenes(lerf)
        assert "nothing is labelled in it" in index.left_out[f"teatime-{file.stem}"]
        assert not {*pair.context} & {*index.scenes["teatime-frame_00005"].context}

    def test_build_index_refuses_bad_folders_in_one_sentence(self, lerf, refusal):
        lerf_ovs = ("--format", "lerf_ovs")
        for data, words, sentence in (
            (lerf, (), "data format 'nerfstudio' has no labels of its own; give their folder"),
            (lerf, ("--format", "stereo", "--labels", lerf), "'stereo' reads no folder"),
            (lerf / "label", lerf_ovs, "no labelled frame has a pair (no labels)"),
            (lerf, (*lerf_ovs, "--set", "min_overlap=0.9", "--set", "max_overlap=0.8"),
             "min_overlap 0.9 is above max_overlap 0.8"),
            (lerf, (*lerf_ovs, "--set", "min_baseline=0.4"), "have it between them"),
            (lerf, ("--pairs", "p.json", "--set", "min_cover=0.8"), "for --data without --pairs"),
        ):  # fmt: skip
            assert sentence in refusal("benchmark", "--data", data, *words, "-o", lerf / "out")
            assert not (lerf / "out" / "pairs.json").exists()


class TestScored:
    def scenes(self, lerf, **extra):
        file = lerf / "pairs.json"
        if not file.exists():
            build_index(lerf, None, IndexSettings(format="lerf_ovs"), file)
        return labelled_scenes(make_settings({"data": lerf, "pairs": file, **extra}, "test"))

    def test_the_stages_read_what_the_index_says(self, lerf, tmp_path):
        scenes, notes = self.scenes(lerf)
        assert "left out by the index" in notes[0]
        settings = make_settings({"size": (80, 120)}, "test")
        photographs, labels, *_ = scene_task(settings, scenes[1]).arguments
        store = ArtifactStore(str(tmp_path / "store"))
        output = ingest.compute(RunContext(store), photographs)
        sample = sample_from_arrays(store.get(output))
        assert [view.name for view in sample.targets] == [FRAMES[4]]
        assert sample.context[0].image.shape == (80, 120, 3)
        result = truth_from_arrays(store.get(truth.compute(RunContext(store), output, labels)))
        mask = result.masks[FRAMES[4]]["sheep"]
        assert mask.mean() == pytest.approx(80 * 60 / 240 / 160, rel=0.1)
        assert result.boxes[FRAMES[4]]["sheep"].tolist() == [[30, 25, 70, 55]]

    def test_pairs_of_one_scene_of_the_data_are_of_one_place(self, lerf):
        scenes, _ = self.scenes(lerf)
        assert [scene.options["scene"] for scene in scenes] == ["ramen", "teatime"]
        settings = make_settings({"against": ["absent-zero", "no-bank"]}, "test")
        for scene in [*scenes, room_scene(3)]:
            rest = baseline_tasks(settings, [scene], {scene.name: {}})
            _, *_, local = scene_task(settings, scene).arguments
            calls = [local, *(job.arguments[2] for job in rest)]
            place = scene.options.get("scene")
            assert [scoring.place for scoring in calls] == [place] * 3
            # Each row is asked by its own rules, and its samples say so.
            assert [scoring.rules.absent for scoring in calls] == ["skip", "skip", "zero"]

    def test_labelled_scenes_refuses_another_format(self, lerf):
        with pytest.raises(InputError, match=r"was made for data of format 'lerf_ovs', but format"):
            self.scenes(lerf, format="ovs3d")
        assert len(self.scenes(lerf, format="lerf_ovs")[0]) == 2

    def test_published_clips_are_scored_where_they_are_there(self, tmp_path, room):
        data = tmp_path / "re10k"
        clip = re10k.encode_clip(room)
        re10k.write(data, [clip])
        file = tmp_path / "index.json"
        inside = {"context": [0, 8], "target": [2, 4, 8]}
        file.write_text(json.dumps({clip.key: inside, "other": {"context": [0, 5], "target": [3]}}))
        settings = {"data": data, "pairs": file}
        (scene,), notes = labelled_scenes(make_settings(settings, "test"))
        assert scene.targets == ["2", "4"]
        assert (scene.labels, scene.categories) == (None, [])
        assert scene.options == {"key": clip.key}
        assert any("1 of the 2 clips" in note for note in notes)
        assert any("is both context and target" in note for note in notes)
        # With labels, in the frames that have them.
        label(tmp_path / "labels" / clip.key, "4.png", "red ball")
        settings["labels"] = tmp_path / "labels"
        (scene,), _ = labelled_scenes(make_settings(settings, "test"))
        assert (scene.targets, scene.categories) == (["4"], ["red ball"])
        shutil.rmtree(tmp_path / "labels" / clip.key)
        with pytest.raises(InputError, match="nothing of it can be scored"):
            labelled_scenes(make_settings(settings, "test"))


def test_name_and_labelled_frames_are_what_a_published_scene_is_known_by():
    frames = [f"frame_{number}" for number in PUBLISHED["lerf_ovs"]["teatime"].split()]
    assert is_published("lerf_ovs", "teatime", reversed(frames))
    assert is_published("ovs3d", "covered_desk", ["00", "01", "11", "26", "29"])
    for format, scene, named in (
        ("lerf_ovs", "ramen", frames), ("colmap", "teatime", frames),
        ("lerf_ovs", "teatime", frames[1:]), ("lerf_ovs", "office", []),
    ):  # fmt: skip
        assert not is_published(format, scene, named)


class TestHeldOut:
    @pytest.fixture
    def ingest_target(self, lerf):
        """Ingest the sample of a target between two context views at a size."""
        store = ArtifactStore(str(lerf / "store"))

        def ingest_target(target: str, size=None):
            scene = SceneSettings(
                name="hall", format="colmap", path=lerf / "ramen", context=FRAMES[1:4:2],
                targets=[target], size=size,
            )  # fmt: skip
            photographs, *_ = scene_task(make_settings({}, "test"), scene).arguments
            return sample_from_arrays(store.get(ingest.compute(RunContext(store), photographs)))

        return ingest_target

    def test_ingest_refuses_a_target_that_equals_a_context_view(self, lerf, ingest_target):
        with pytest.raises(InputError, match=r"the target 'frame_00004\.jpg' is the context view"):
            ingest_target("frame_00004")
        images = lerf / "ramen" / "images"
        shutil.copy(images / FRAMES[1], images / FRAMES[2])
        for size in (None, "at most 24x32"):  # targets keep the size that all are judged at
            with pytest.raises(InputError, match="is the same picture as the context view"):
                ingest_target(FRAMES[2], size)

    @pytest.mark.parametrize("size", ["at most 24x32", (30, 20)])
    def test_all_are_judged_at_one_size_but_where_a_size_crops(self, ingest_target, size):
        sample = ingest_target(FRAMES[2], size)
        (target,) = sample.targets
        assert target.image.shape[:2] == (size if isinstance(size, tuple) else SIZE[::-1])
        if size == "at most 24x32":
            assert 2 * sample.context[0].image[..., 0].size < target.image[..., 0].size


def test_build_index_refuses_two_pairs_of_one_name(lerf):
    label(lerf / "label/teatime/a", "b.jpg")
    label(lerf / "label/teatime", "a-b.jpg")
    with pytest.raises(InputError, match="both be called 'teatime-a-b'; rename a"):
        index_scenes(lerf)
