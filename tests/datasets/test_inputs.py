"""A cached result is what an empty store gives, whatever happened to the data since."""

import gc
import os
import pickle
import shutil
import sys

import numpy as np
import pytest
from data_folders import ASKED, WRITERS, save, write_folder
from PIL import Image
from prefect.states import State
from test_unposed import made_up

from slgaussian import datasets
from slgaussian.datasets import unposed
from slgaussian.errors import InputError
from slgaussian.storage.store import ArtifactStore
from tasks.chunks import PosedFolder, packed
from tasks.context import RunContext, run_context
from tasks.scene import Labels, Photographs, ingest, truth


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
    context = RunContext(ArtifactStore(str(store)))
    try:
        with run_context(context):
            made = stage.task.fn([], [], arguments)
    except InputError as error:
        return str(error), False
    cached = isinstance(made, State)
    ref = (made.result() if cached else made).ref
    return (ref.digest, ref.meta.get("cameras"), ref.meta.get("left_out")), cached


def photographs(folder, store):
    one = Photographs("s", folder.format, folder.path, folder.options, folder.asked)
    return answer(ingest, {"photographs": one}, store)


def posed(folder, store):
    return answer(packed, {"source": PosedFolder("s", folder.path)}, store)


def compare(tmp_path, write, ask):
    """Ask after every change to data, with the results of all before and with none."""
    root, store = tmp_path / "data", tmp_path / "store"
    data = write(root)
    first, _ = ask(data, store)
    assert not isinstance(first, str)
    assert ask(write(tmp_path / "copied"), store) == (first, True)
    others = 0
    for number, what in enumerate(data.changes()):
        shutil.rmtree(root)
        data = write(root)
        data.changes()[what](data)
        resumed, cached = ask(data, store)
        if cached:  # else it was made just now
            fresh, _ = ask(data, tmp_path / f"empty{number}")
            assert resumed == fresh, what
        others += resumed != first
    assert others >= 2


@pytest.mark.parametrize(
    ("name", "ask"),
    [(name, photographs) for name in ("nerfstudio", "colmap", "re10k", "photographs")]
    + [("llff", posed)],
)
def test_a_resumed_run_reads_what_an_empty_store_would(tmp_path, name, ask):
    compare(tmp_path, lambda root: write_folder(name, root), ask)


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "re10k"])
def test_a_scene_can_be_sent_to_another_process(tmp_path, name):
    folder = write_folder(name, tmp_path)
    scene = datasets.load(folder.format, folder.path, **folder.options)
    again = pickle.loads(pickle.dumps(scene))
    for view in scene.cameras:
        np.testing.assert_array_equal(again.read(view).image, scene.read(view).image)


def test_every_reader_is_tried():
    """But for npz, which needs photographs that match: test_npz.py tries it."""
    assert set(datasets.FROM_FILES) - {"npz"} <= set(WRITERS)


class Labelled:
    """A scene with masks of two classes for each of two targets."""

    def __init__(self, root):
        self.scene, self.labels = write_folder("nerfstudio", root / "scene"), root / "labels"
        for name in ASKED:
            self.draw(name)
        (self.labels / "classes.txt").write_text("ball\ncup\n")

    def draw(self, name, at=8):
        for category in ("ball", "cup"):
            mask = np.zeros((64, 96), np.uint8)
            mask[at : at + 20, at : at + 20] = 255
            (self.labels / name).mkdir(parents=True, exist_ok=True)
            Image.fromarray(mask).save(self.labels / name / f"{category}.png", compress_level=0)

    def edit_in_place(self):
        file = self.labels / "view_2/ball.png"
        before = file.stat()
        self.draw("view_2", at=9)
        os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
        assert file.stat().st_size == before.st_size

    def changes(self):
        classes = self.labels / "classes.txt"
        return {
            "one is edited, its size and time as before": lambda _: self.edit_in_place(),
            "one is renamed": lambda _: (self.labels / "view_2").rename(self.labels / "view_3"),
            "one is added": lambda _: self.draw("view_3"),
            "a class is added": lambda _: classes.write_text("ball\ncup\nbox\n"),
            "photographs are edited": lambda _: save(self.scene.photograph(1), 60),
        }


def test_truth_is_read_anew_when_labels_change(tmp_path):
    def ask(data, store):
        folder = data.scene
        asked = Photographs("s", folder.format, folder.path, {}, ("view_10", "view_30"), ASKED)
        context = RunContext(ArtifactStore(str(store)))
        with run_context(context):
            made = ingest.task.fn([], [], {"photographs": asked})
        sample = (made.result() if isinstance(made, State) else made).ref
        labels = Labels(data.labels, ASKED, ("ball", "box")).of_views(sample.meta["targets"])
        return answer(truth, {"sample": sample, "labels": labels}, store)

    compare(tmp_path, Labelled, ask)


opened = None


def listen(event, arguments):
    if opened is not None and event == "open" and isinstance(arguments[0], str | os.PathLike):
        opened.add(os.path.realpath(arguments[0]))


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "llff file"])
def test_a_reader_names_every_file_that_it_opens(tmp_path, name):
    global opened
    folder = write_folder(name, tmp_path)
    sys.addaudithook(listen)
    opened = set()
    scene = datasets.load(folder.format, folder.path, **folder.options)
    views = list(scene.cameras)
    for view in views:
        scene.read(view)
    paths, opened = opened, None
    files, _ = datasets.inputs(folder.format, folder.path, views, **folder.options)
    read = {path for path in paths if path.startswith(f"{tmp_path}/")}
    assert len(read) >= 2
    # Which chunk a clip is in is all that the index decides.
    assert read - {str(tmp_path / "index.json")} <= {os.path.realpath(file) for file in files}


def test_data_that_change_while_they_are_read_are_refused(tmp_path, monkeypatch):
    folder = write_folder("llff", tmp_path / "data")
    read = Photographs.read

    def slowly(self):
        save(folder.photograph(1), 99)
        return read(self)

    monkeypatch.setattr(Photographs, "read", slowly)
    assert "was changed after the run had begun" in photographs(folder, tmp_path / "store")[0]
    monkeypatch.undo()
    assert not isinstance(photographs(folder, tmp_path / "store")[0], str)
