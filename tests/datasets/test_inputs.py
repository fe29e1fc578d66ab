"""A cached result is what an empty store gives, whatever happened to the data since."""

import gc
import io
import json
import os
import pickle
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from posed_folders import FOCAL, HEIGHT, WIDTH, Shot, llff_row, picture, write_model
from prefect.states import State
from test_unposed import made_up

from slgaussian import datasets
from slgaussian.datasets import re10k, unposed
from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactStore
from tasks.chunks import PosedFolder, packed
from tasks.context import RunContext, run_context
from tasks.scene import Labels, Photographs, ingest, truth

NAMES = ("view_10.png", "view_2.png", "view_30.png", "view_4.png")
"""By name; by number the first comes third."""

ASKED = ("view_2", "view_4")
XS, ORDER = [0, 0.1, 0.2, 0.3], [0, 1, 2, 3]
OPTIONS = {"re10k": {"key": "one"}}


def save(file: Path, seed: int, width: int = WIDTH, height: int = HEIGHT) -> None:
    """Write a photograph, as PNG in as many bytes as any other of its size."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture(seed, width, height)).save(file, compress_level=0)


def edit_in_place(file: Path, edit) -> None:
    """Change a file but neither its size nor its time."""
    before = file.stat()
    edit()
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert file.stat().st_size == before.st_size


def write_nerfstudio(root, xs=XS, order=ORDER, **keys):
    for number, name in enumerate(NAMES):
        np.save(root / Path(name).with_suffix(".npy"), np.full((HEIGHT, WIDTH), 2.0 + number))
    frames = []
    for number in order:
        pose = np.eye(4)
        pose[0, 3] = xs[number]
        stem = Path(NAMES[number]).stem
        frame = {"file_path": f"images/{stem}", "depth_file_path": f"{stem}.npy"}
        frames.append({**frame, "transform_matrix": pose.tolist()})
    # Neither w nor h: they are those of the first photograph that is there.
    (root / "transforms.json").write_text(json.dumps({"fl_x": FOCAL, "frames": frames, **keys}))


def write_colmap(root, xs=XS, order=ORDER, text=True):
    shots = {NAMES[n]: Shot(1 + place, place=(xs[n], 0, 0)) for place, n in enumerate(order)}
    write_model(root / "sparse/0", shots, text=text)


def write_llff(root, xs=XS, order=ORDER):
    np.save(root / "poses_bounds.npy", [llff_row((xs[number], 0, 0)) for number in order])


def write_re10k(root, one=(1, 0.1), two=(2, 0.1)):
    """Two clips, each of a seed and a step between cameras; None leaves it out."""
    shutil.rmtree(root, ignore_errors=True)
    clips = []
    for key, (seed, step) in {"one": one, "two": two or (0, 0)}.items():
        images = []
        for number in range(4):
            stream = io.BytesIO()
            Image.fromarray(picture(10 * seed + number)).save(stream, "JPEG")
            images.append(stream.getvalue())
        rows = np.zeros((4, 18), np.float32)
        rows[:] = (0.8, 1.2, 0.5, 0.5, 0, 0, *np.eye(4)[:3].ravel())
        rows[:, 9] = -step * np.arange(4)
        clips.append(re10k.Clip(key, "", np.arange(4), rows, tuple(images)))
    re10k.write(root, clips if two else clips[:1])


CAMERAS = {
    "nerfstudio": write_nerfstudio,
    "colmap": write_colmap,
    "llff": write_llff,
    "photographs": lambda root: None,
    "re10k": write_re10k,
}
"""Writes the cameras of a format: the x of the four photographs, in the order of these numbers."""


def write(format: str, root: Path) -> Path:
    if format != "re10k":
        for number, name in enumerate(NAMES):
            save(root / "images" / name, number)
    CAMERAS[format](root)
    return root


def changes(format: str, root: Path) -> dict:
    """All that may happen to the data, by what it is."""
    if format == "re10k":
        return {
            "a photograph is edited": lambda: write_re10k(root, one=(3, 0.1)),
            "a camera is moved": lambda: write_re10k(root, one=(1, 0.2)),
            "another clip is edited": lambda: write_re10k(root, two=(3, 0.1)),
            "another clip is removed": lambda: write_re10k(root, two=None),
            "the chunk is cut short": lambda: os.truncate(root / "000000.torch", 2000),
        }
    files = [root / "images" / name for name in NAMES]
    happens = {
        "an asked photograph is edited in place": lambda: edit_in_place(
            files[1], lambda: save(files[1], 77)
        ),
        "another is edited": lambda: save(files[0], 78),
        "another is smaller": lambda: save(files[0], 0, WIDTH // 2, HEIGHT // 2),
        "an asked one is cut short": lambda: os.truncate(files[1], 999),
        "another is renamed and comes first": lambda: files[2].rename(root / "images/a.png"),
        "an asked one is removed": lambda: files[3].unlink(),
        "one is added": lambda: save(root / "images/view_3.png", 50),
        "one is added with another ending": lambda: save(files[1].with_suffix(".jpg"), 51),
    }
    write = CAMERAS[format]
    if format != "photographs":
        happens["an asked camera is moved"] = lambda: write(root, [0, 0.15, 0.2, 0.3])
        happens["cameras stand in another order"] = lambda: write(root, XS, [3, 1, 0, 2])
    if format == "nerfstudio":
        depth = root / "view_2.npy"
        happens["an asked depth is edited"] = lambda: np.save(depth, np.ones((HEIGHT, WIDTH)))
        happens["a lens is stated"] = lambda: write(root, k1=0.1)
    if format == "colmap":
        happens["a binary model is added"] = lambda: write(root, [0, 0.2, 0.3, 0.4], text=False)
    return happens


@pytest.fixture(autouse=True, scope="module")
def quick():
    """Spare seconds: cameras of photographs are made up, and old objects not collected."""
    gc.freeze()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(unposed, "find_cameras", made_up)
        unposed._find.cache_clear()
        yield
    unposed._find.cache_clear()
    gc.unfreeze()


def answer(stage, arguments, store):
    """What a stage makes in a store, or why it refuses; and whether it was there."""
    with run_context(RunContext(ArtifactStore(str(store)))):
        try:
            made = stage.task.fn([], [], arguments)
        except InputError as error:
            return str(error), False
    cached = isinstance(made, State)
    ref = (made.result() if cached else made).ref
    return (ref.digest, ref.meta.get("cameras"), ref.meta.get("left_out")), cached


def ask(format, root, store):
    """Read the second and the fourth view; or all, as `dataset` does with a folder."""
    if format == "llff":
        return answer(packed, {"source": PosedFolder("s", root)}, store)
    asked = ("1", "3") if format == "re10k" else ASKED
    one = Photographs("s", format, root, OPTIONS.get(format, {}), asked)
    return answer(ingest, {"photographs": one}, store)


def compare(tmp_path, write, changes, ask):
    """Ask after every change to data, with the results of all before and with none."""
    root, store = tmp_path / "data", tmp_path / "store"
    write(root)
    first, _ = ask(root, store)
    assert not isinstance(first, str)
    assert ask(write(tmp_path / "copied"), store) == (first, True)
    others = 0
    for number, (what, change) in enumerate(changes(root).items()):
        shutil.rmtree(root)
        write(root)
        change()
        resumed, cached = ask(root, store)
        if cached:  # else it was made just now
            assert resumed == ask(root, tmp_path / f"empty{number}")[0], what
        others += resumed != first
    assert others >= 2


@pytest.mark.parametrize("format", CAMERAS)
def test_a_resumed_run_reads_what_an_empty_store_would(tmp_path, format):
    compare(
        tmp_path,
        lambda root: write(format, root),
        lambda root: changes(format, root),
        lambda root, store: ask(format, root, store),
    )


def test_truth_is_read_anew_when_labels_change(tmp_path):
    def draw(root, name, at=8):
        for category in ("ball", "cup"):
            mask = np.zeros((64, 96), np.uint8)
            mask[at : at + 20, at : at + 20] = 255
            (root / "labels" / name).mkdir(parents=True, exist_ok=True)
            file = root / "labels" / name / f"{category}.png"
            Image.fromarray(mask).save(file, compress_level=0)

    def write_labelled(root):
        write("nerfstudio", root)
        for name in ASKED:
            draw(root, name)
        (root / "labels/classes.txt").write_text("ball\ncup\n")
        return root

    def changes(root):
        labels, ball = root / "labels", root / "labels/view_2/ball.png"
        return {
            "one is edited in place": lambda: edit_in_place(ball, lambda: draw(root, "view_2", 9)),
            "one is renamed": lambda: (labels / "view_2").rename(labels / "view_3"),
            "one is added": lambda: draw(root, "view_3"),
            "a class is added": lambda: (labels / "classes.txt").write_text("ball\ncup\nbox\n"),
            "photographs are edited": lambda: save(root / "images" / NAMES[1], 60),
        }

    def ask(root, store):
        asked = Photographs("s", "nerfstudio", root, {}, ("view_10", "view_30"), ASKED)
        with run_context(RunContext(ArtifactStore(str(store)))):
            made = ingest.task.fn([], [], {"photographs": asked})
        sample = (made.result() if isinstance(made, State) else made).ref
        labels = Labels(root / "labels", ASKED, ("ball", "box")).of_views(sample.meta["targets"])
        return answer(truth, {"sample": sample, "labels": labels}, store)

    compare(tmp_path, write_labelled, changes, ask)


opened = None


def listen(event, arguments):
    if opened is not None and event == "open" and isinstance(arguments[0], str | os.PathLike):
        opened.add(os.path.realpath(arguments[0]))


@pytest.mark.parametrize("format", CAMERAS)
def test_a_scene_can_be_sent_elsewhere_and_names_every_file_that_it_opens(tmp_path, format):
    global opened
    write(format, tmp_path)
    options = OPTIONS.get(format, {})
    sys.addaudithook(listen)
    opened = set()
    scene = datasets.load(format, tmp_path, **options)
    images = {name: scene.read(name).image for name in scene.cameras}
    paths, opened = opened, None
    files, _ = datasets.inputs(format, tmp_path, list(images), **options)
    read = {path for path in paths if path.startswith(f"{tmp_path}/")}
    assert len(read) >= 2
    # Which chunk a clip is in is all that the index decides.
    assert read - {str(tmp_path / "index.json")} <= {os.path.realpath(file) for file in files}
    if format != "re10k":
        again = pickle.loads(pickle.dumps(scene))
        for name, image in images.items():
            np.testing.assert_array_equal(again.read(name).image, image)


def test_data_that_change_while_they_are_read_are_refused(tmp_path, monkeypatch):
    write("nerfstudio", tmp_path / "data")
    read = Photographs.read

    def slowly(self):
        save(tmp_path / "data/images" / NAMES[1], 99)
        return read(self)

    monkeypatch.setattr(Photographs, "read", slowly)
    said, _ = ask("nerfstudio", tmp_path / "data", tmp_path / "store")
    assert "was changed after the run had begun" in said
    monkeypatch.undo()
    assert not isinstance(ask("nerfstudio", tmp_path / "data", tmp_path / "store")[0], str)
