"""A cached result is what an empty store gives, whatever happened to the data since."""

import gc
import json
import os
import pickle
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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

Change = Callable[["Folder"], object]


def save(file: Path, seed: int, width: int = WIDTH, height: int = HEIGHT, **options: Any) -> None:
    """Write a photograph, as PNG in as many bytes as any other of its size."""
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture(seed, width, height)).save(file, compress_level=0, **options)


@dataclass
class Folder:
    """Data of one scene.

    Attributes:
        path: What is given for it.
        images: Folder of the photographs.
        options: Of the format.
        asked: tuple of str. The views that are asked for: the second and the fourth.
        write: Writes the cameras with these x of the four photographs, in the order of these
            numbers.
        more: {what: change}. That may happen to this format only.
    """

    format: str
    path: Path
    images: Path
    options: Mapping[str, Any] = field(default_factory=dict)
    asked: tuple[str, ...] = ASKED
    write: Callable[[list[float], list[int]], object] | None = None
    more: Mapping[str, Change] = field(default_factory=dict)

    def photograph(self, number: int) -> Path:
        """The file of a photograph."""
        return self.images / NAMES[number]

    def changes(self) -> dict[str, Change]:
        """All that may happen to it, by what it is."""
        if self.format == "re10k":
            return dict(self.more)
        cameras: dict[str, Change] = {}
        if self.write is not None:
            write = self.write
            cameras = {
                "an asked camera is moved": lambda _: write([0, 0.15, 0.2, 0.3], [0, 1, 2, 3]),
                "cameras stand in another order": lambda _: write([0, 0.1, 0.2, 0.3], [3, 1, 0, 2]),
            }
        return CHANGES | cameras | dict(self.more)


def _edit_in_place(folder: Folder) -> None:
    file = folder.photograph(1)
    before = file.stat()
    save(file, 77)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert file.stat().st_size == before.st_size


CHANGES: dict[str, Change] = {
    "an asked photograph is edited, its size and time as before": _edit_in_place,
    "another is edited": lambda folder: save(folder.photograph(0), 78),
    "another is smaller": lambda folder: save(folder.photograph(0), 0, WIDTH // 2, HEIGHT // 2),
    "an asked one is cut short": lambda folder: os.truncate(folder.photograph(1), 999),
    "another is renamed and comes first": lambda folder: folder.photograph(2).rename(
        folder.images / "a.png"
    ),
    "an asked one is removed": lambda folder: folder.photograph(3).unlink(),
    "one is added": lambda folder: save(folder.images / "view_3.png", 50),
    "one is added beside with another ending": lambda folder: save(
        folder.photograph(1).with_suffix(".jpg"), 51
    ),
}


def _photographs(folder: Path, names: tuple[str, ...] = NAMES) -> None:
    for number, name in enumerate(names):
        save(folder / name, number)


def _nerfstudio(root: Path) -> Folder:
    _photographs(root / "images")
    for number, name in enumerate(NAMES):
        depth = np.full((HEIGHT, WIDTH), 2.0 + number)
        np.save(root / Path(name).with_suffix(".npy"), depth)

    def write(xs: list[float], order: list[int], **keys: Any) -> None:
        frames = []
        for number in order:
            pose = np.eye(4)
            pose[0, 3] = xs[number]
            name = NAMES[number]
            frames.append(
                {
                    "file_path": f"images/{Path(name).stem}",
                    "transform_matrix": pose.tolist(),
                    "depth_file_path": Path(name).with_suffix(".npy").name,
                }
            )
        # Neither w nor h: they are those of the first photograph that is there.
        content = {"fl_x": FOCAL, "frames": frames, **keys}
        (root / "transforms.json").write_text(json.dumps(content))

    xs, order = [0, 0.1, 0.2, 0.3], [0, 1, 2, 3]
    write(xs, order)
    depth = root / "view_2.npy"
    more: dict[str, Change] = {
        "an asked depth is edited": lambda _: np.save(depth, np.ones((HEIGHT, WIDTH))),
        "a lens is stated": lambda _: write(xs, order, k1=0.1),
    }
    return Folder("nerfstudio", root, root / "images", write=write, more=more)


def _colmap(root: Path) -> Folder:
    _photographs(root / "images")

    def write(xs: list[float], order: list[int], text: bool = True) -> None:
        shots = {
            NAMES[number]: Shot(1 + place, place=(xs[number], 0, 0))
            for place, number in enumerate(order)
        }
        write_model(root / "sparse/0", shots, text=text)

    write([0, 0.1, 0.2, 0.3], [0, 1, 2, 3])
    more: dict[str, Change] = {
        "a binary model is added": lambda _: write([0, 0.2, 0.3, 0.4], [0, 1, 2, 3], text=False),
    }
    return Folder("colmap", root, root / "images", write=write, more=more)


def _llff(root: Path) -> Folder:
    _photographs(root / "images")

    def write(xs: list[float], order: list[int]) -> None:
        np.save(root / "poses_bounds.npy", [llff_row((xs[number], 0, 0)) for number in order])

    write([0, 0.1, 0.2, 0.3], [0, 1, 2, 3])
    return Folder("llff", root, root / "images", write=write)


def _photographs_alone(root: Path) -> Folder:
    _photographs(root / "images")
    return Folder("photographs", root, root / "images")


def _re10k(root: Path) -> Folder:
    def clip(key: str, seed: int, step: float = 0.1) -> re10k.Clip:
        images = []
        for number in range(4):
            save(root / "frame.jpg", 10 * seed + number)
            images.append((root / "frame.jpg").read_bytes())
            (root / "frame.jpg").unlink()
        rows = np.zeros((4, 18), np.float32)
        rows[:] = (0.8, 1.2, 0.5, 0.5, 0, 0, *np.eye(4)[:3].ravel())
        rows[:, 9] = -step * np.arange(4)
        return re10k.Clip(key, "https://example.org/x", np.arange(4), rows, tuple(images))

    def write(*clips: re10k.Clip) -> None:
        for file in root.iterdir():
            file.unlink()
        re10k.write(root, clips)

    root.mkdir(parents=True, exist_ok=True)
    one, two = clip("one", 1), clip("two", 2)
    write(one, two)
    more: dict[str, Change] = {
        "a photograph is edited": lambda _: write(clip("one", 3), two),
        "a camera is moved": lambda _: write(clip("one", 1, 0.2), two),
        "another clip is edited": lambda _: write(one, clip("two", 3)),
        "another clip is removed": lambda _: write(one),
        "the chunk is cut short": lambda _: os.truncate(root / "000000.torch", 2000),
    }
    return Folder("re10k", root, root, {"key": "one"}, asked=("1", "3"), more=more)


WRITERS: dict[str, Callable[[Path], Folder]] = {
    "nerfstudio": _nerfstudio,
    "colmap": _colmap,
    "llff": _llff,
    "re10k": _re10k,
    "photographs": _photographs_alone,
}


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
    compare(tmp_path, lambda root: WRITERS[name](root), ask)


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "re10k"])
def test_a_scene_can_be_sent_to_another_process(tmp_path, name):
    folder = WRITERS[name](tmp_path)
    scene = datasets.load(folder.format, folder.path, **folder.options)
    again = pickle.loads(pickle.dumps(scene))
    for view in scene.cameras:
        np.testing.assert_array_equal(again.read(view).image, scene.read(view).image)


class Labelled:
    """A scene with masks of two classes for each of two targets."""

    def __init__(self, root):
        self.scene, self.labels = WRITERS["nerfstudio"](root / "scene"), root / "labels"
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


@pytest.mark.parametrize("name", WRITERS)
def test_a_reader_names_every_file_that_it_opens(tmp_path, name):
    global opened
    folder = WRITERS[name](tmp_path)
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
    folder = WRITERS["llff"](tmp_path / "data")
    read = Photographs.read

    def slowly(self):
        save(folder.photograph(1), 99)
        return read(self)

    monkeypatch.setattr(Photographs, "read", slowly)
    assert "was changed after the run had begun" in photographs(folder, tmp_path / "store")[0]
    monkeypatch.undo()
    assert not isinstance(photographs(folder, tmp_path / "store")[0], str)
