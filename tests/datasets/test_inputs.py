"""Cached results of changed data: a resumed run returns what an empty store would."""

import gc
import io
import json
import os
import pickle
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from posed_folders import FOCAL, HEIGHT, WIDTH, Shot, llff_row, picture, write_model
from test_unposed import side_by_side

from slgaussian import datasets
from slgaussian.datasets import re10k, unposed
from slgaussian.datasets.sources import Photographs, PosedFolder
from slgaussian.errors import InputError
from tasks.chunks import packed
from tasks.scene import Labels, ingest, truth
from tests.plain_stages import call

NAMES = ("view_10.png", "view_2.png", "view_30.png", "view_4.png")
"""Sorted by name; in numeric order the first is the third."""

REQUESTED = ("view_2", "view_4")
XS, ORDER = [0, 0.1, 0.2, 0.3], [0, 1, 2, 3]
OPTIONS = {"re10k": {"key": "one"}}


def save(file: Path, seed: int, width: int = WIDTH, height: int = HEIGHT) -> None:
    """Write a photograph as an uncompressed PNG: all of one size have as many bytes."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture(seed, width, height)).save(file, compress_level=0)


def edit_in_place(file: Path, edit) -> None:
    """Change a file's content, not its size and modification time."""
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
    # Without w and h, whose default is the size of the first photograph on disk.
    (root / "transforms.json").write_text(json.dumps({"fl_x": FOCAL, "frames": frames, **keys}))


def write_colmap(root, xs=XS, order=ORDER, text=True):
    shots = {NAMES[n]: Shot(1 + place, place=(xs[n], 0, 0)) for place, n in enumerate(order)}
    write_model(root / "sparse/0", shots, text=text)


def write_llff(root, xs=XS, order=ORDER):
    np.save(root / "poses_bounds.npy", [llff_row((xs[number], 0, 0)) for number in order])


def write_re10k(root, first=(1, 0.1), second=(2, 0.1)):
    """Write two clips, each of a seed and a step between cameras; None leaves out the second."""
    shutil.rmtree(root, ignore_errors=True)
    clips = []
    for key, (seed, step) in {"one": first, "two": second or (0, 0)}.items():
        images = []
        for number in range(4):
            stream = io.BytesIO()
            Image.fromarray(picture(10 * seed + number)).save(stream, "JPEG")
            images.append(stream.getvalue())
        rows = np.zeros((4, 18), np.float32)
        rows[:] = (0.8, 1.2, 0.5, 0.5, 0, 0, *np.eye(4)[:3].ravel())
        rows[:, 9] = -step * np.arange(4)
        clips.append(re10k.Clip(key, "", np.arange(4), rows, tuple(images)))
    re10k.write(root, clips if second else clips[:1])


CAMERA_WRITERS = {
    "nerfstudio": write_nerfstudio,
    "colmap": write_colmap,
    "llff": write_llff,
    "photographs": lambda root: None,
    "re10k": write_re10k,
}
"""By format: takes x of the four cameras, and the order in which to write them."""


def write(format: str, root: Path) -> Path:
    if format != "re10k":
        for number, name in enumerate(NAMES):
            save(root / "images" / name, number)
    CAMERA_WRITERS[format](root)
    return root


def changes(format: str, root: Path) -> dict:
    """Return functions that change the data, by a description."""
    if format == "re10k":
        return {
            "requested photograph edited": lambda: write_re10k(root, first=(3, 0.1)),
            "requested camera moved": lambda: write_re10k(root, first=(1, 0.2)),
            "other clip edited": lambda: write_re10k(root, second=(3, 0.1)),
            "other clip removed": lambda: write_re10k(root, second=None),
            "chunk truncated": lambda: os.truncate(root / "000000.torch", 2000),
        }
    files = [root / "images" / name for name in NAMES]
    edits = {
        "requested photograph edited in place": lambda: edit_in_place(
            files[1], lambda: save(files[1], 77)
        ),
        "other photograph edited": lambda: save(files[0], 78),
        "other photograph shrunk": lambda: save(files[0], 0, WIDTH // 2, HEIGHT // 2),
        "requested photograph truncated": lambda: os.truncate(files[1], 999),
        "other photograph renamed to sort first": lambda: files[2].rename(root / "images/a.png"),
        "requested photograph removed": lambda: files[3].unlink(),
        "photograph added": lambda: save(root / "images/view_3.png", 50),
        "same stem, other suffix added": lambda: save(files[1].with_suffix(".jpg"), 51),
    }

    def add_mask():
        (root / "masks").mkdir()
        mask = np.repeat([[0, 255]], HEIGHT, 0).repeat(WIDTH // 2, 1).astype(np.uint8)
        Image.fromarray(mask).save(root / "masks" / NAMES[1])

    edits["mask of a requested photograph added"] = add_mask
    write = CAMERA_WRITERS[format]
    if format != "photographs":
        edits["requested camera moved"] = lambda: write(root, [0, 0.15, 0.2, 0.3])
        edits["cameras reordered"] = lambda: write(root, XS, [3, 1, 0, 2])
    if format == "nerfstudio":
        depth = root / "view_2.npy"
        edits["requested depth edited"] = lambda: np.save(depth, np.ones((HEIGHT, WIDTH)))
        edits["lens distortion added"] = lambda: write(root, k1=0.1)
    if format == "colmap":
        edits["binary model added"] = lambda: write(root, [0, 0.2, 0.3, 0.4], text=False)
    return edits


@pytest.fixture(autouse=True, scope="module")
def fast_ingest():
    """Replace camera estimation, and exempt old objects from collection, to save seconds."""
    gc.freeze()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(unposed, "find_cameras", side_by_side)
        unposed._find.cache_clear()
        yield
    unposed._find.cache_clear()
    gc.unfreeze()


def run_stage(stage, arguments, store):
    """Return a stage's result, or the text of its refusal; and if it was in the store."""
    try:
        ref, cached = call(stage, store, **arguments)
    except InputError as error:
        return str(error), False
    return (ref.digest, ref.meta.get("cameras"), ref.meta.get("left_out")), cached


def ingest_data(format, root, store):
    """Ingest the second and fourth view; of LLFF pack all views, as `dataset` does."""
    if format == "llff":
        return run_stage(packed, {"source": PosedFolder("s", root)}, store)
    views = ("1", "3") if format == "re10k" else REQUESTED
    photographs = Photographs("s", format, root, OPTIONS.get(format, {}), views)
    return run_stage(ingest, {"photographs": photographs}, store)


def check_cache(tmp_path, write, changes, run):
    """Run after every change of the data, on a store of all earlier results and on an empty one."""
    root, store = tmp_path / "data", tmp_path / "store"
    write(root)
    first, _ = run(root, store)
    assert not isinstance(first, str)
    assert run(write(tmp_path / "copied"), store) == (first, True)
    different = 0
    for number, (description, change) in enumerate(changes(root).items()):
        shutil.rmtree(root)
        write(root)
        change()
        resumed, cached = run(root, store)
        if cached:
            assert resumed == run(root, tmp_path / f"empty{number}")[0], description
        different += resumed != first
    assert different >= 2


@pytest.mark.parametrize("format", CAMERA_WRITERS)
def test_cached_views_equal_those_of_an_empty_store(tmp_path, format):
    check_cache(tmp_path, *(partial(step, format) for step in (write, changes, ingest_data)))


def test_cached_truth_equals_that_of_an_empty_store(tmp_path):
    def draw(root, name, at=8):
        mask = np.zeros((64, 96), np.uint8)
        mask[at : at + 20, at : at + 20] = 255
        (root / "labels" / name).mkdir(parents=True, exist_ok=True)
        for category in ("ball", "cup"):
            file = root / "labels" / name / f"{category}.png"
            Image.fromarray(mask).save(file, compress_level=0)

    def write_labels(root):
        write("nerfstudio", root)
        for name in REQUESTED:
            draw(root, name)
        (root / "labels/classes.txt").write_text("ball\ncup\n")
        return root

    def changes(root):
        labels, ball = root / "labels", root / "labels/view_2/ball.png"
        return {
            "mask edited in place": lambda: edit_in_place(ball, lambda: draw(root, "view_2", 9)),
            "labelled view renamed": lambda: (labels / "view_2").rename(labels / "view_3"),
            "labelled view added": lambda: draw(root, "view_3"),
            "class added": lambda: (labels / "classes.txt").write_text("ball\ncup\nbox\n"),
            "photograph edited": lambda: save(root / "images" / NAMES[1], 60),
        }

    def read_truth(root, store):
        views = Photographs("s", "nerfstudio", root, {}, ("view_10", "view_30"), REQUESTED)
        sample, _ = call(ingest, store, photographs=views)
        labels = Labels(root / "labels", REQUESTED, ("ball", "box"))
        labels = labels.of_views(sample.meta["targets"])
        return run_stage(truth, {"sample": sample, "labels": labels}, store)

    check_cache(tmp_path, write_labels, changes, read_truth)


@pytest.mark.parametrize("format", CAMERA_WRITERS)
def test_inputs_list_every_opened_file_of_a_scene(tmp_path, format):
    write(format, tmp_path)
    opened, recording = set(), True

    def record_open(event, arguments):
        if recording and event == "open" and isinstance(arguments[0], str | os.PathLike):
            opened.add(os.path.realpath(arguments[0]))

    sys.addaudithook(record_open)
    options = OPTIONS.get(format, {})
    scene = datasets.load(format, tmp_path, **options)
    images = {name: scene.read(name).image for name in scene.cameras}
    recording = False
    files, _ = datasets.inputs(format, tmp_path, list(images), **options)
    read = {path for path in opened if path.startswith(f"{tmp_path}/")}
    assert len(read) >= 2
    # The index only names the chunk of a clip, which is an input itself.
    assert read - {str(tmp_path / "index.json")} <= {os.path.realpath(file) for file in files}
    if format != "re10k":
        restored = pickle.loads(pickle.dumps(scene))
        for name, image in images.items():
            np.testing.assert_array_equal(restored.read(name).image, image)


def test_ingest_refuses_data_changed_during_the_run(tmp_path, monkeypatch):
    root, store = tmp_path / "data", tmp_path / "store"
    write("nerfstudio", root)
    read = Photographs.read

    def change_and_read(self):
        save(root / "images" / NAMES[1], 99)
        return read(self)

    monkeypatch.setattr(Photographs, "read", change_and_read)
    refusal, _ = ingest_data("nerfstudio", root, store)
    assert "was changed after the run had begun" in refusal
    monkeypatch.undo()
    assert not isinstance(ingest_data("nerfstudio", root, store)[0], str)
