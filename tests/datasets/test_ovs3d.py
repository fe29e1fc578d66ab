import numpy as np
import pytest
from PIL import Image
from posed_folders import HEIGHT, WIDTH, Shot, llff_row, write_model, write_pictures

from slgaussian.benchmark.annotations import labelled_frames, read_labels
from slgaussian.datasets import load, scenes
from slgaussian.errors import InputError

NAMES = ["00.jpg", "01.jpg", "02.jpg"]
CLASSES = ("white sheet", "a stack of UNO cards", "hand")


def ring() -> np.ndarray:
    """A mask with a hole, uint8 [HEIGHT, WIDTH]."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[10:50, 20:70] = 255
    mask[20:40, 30:60] = 0
    return mask


def edge() -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, :4] = 255
    return mask


@pytest.fixture
def folder(tmp_path):
    bed = tmp_path / "bed"
    write_pictures(bed / "images", NAMES)
    np.save(bed / "poses_bounds.npy", [llff_row((0.1 * i, 0, 0)) for i in range(3)])
    (bed / "segmentations/01").mkdir(parents=True)
    (bed / "segmentations/classes.txt").write_text("\n".join(CLASSES) + "\n\n")
    for name, mask in zip(CLASSES, (ring(), edge(), 0 * edge()), strict=True):
        Image.fromarray(mask).save(bed / f"segmentations/01/{name}.png")
    return tmp_path


class TestCameras:
    def test_are_those_of_poses_bounds_where_there_is_nothing_else(self, folder):
        assert scenes("ovs3d", folder) == {"bed": {"scene": "bed"}}
        scene = load("ovs3d", folder, "bed")
        assert list(scene.cameras) == NAMES
        assert scene.cameras["01.jpg"].K[0, 2] == WIDTH / 2

    def test_are_those_of_the_model_where_it_is_there(self, folder):
        shots = {name: Shot(3 - i, place=(0.1 * i, 0, 0)) for i, name in enumerate(NAMES)}
        write_model(folder / "bed/sparse/0", shots)
        assert load("ovs3d", folder, "bed").cameras["01.jpg"].K[0, 2] == 47.3


class TestMasks:
    def test_are_read_with_their_holes(self, folder):
        labels = folder / "bed/segmentations"
        masks = read_labels(labels, "01.jpg", WIDTH, HEIGHT)
        assert list(masks) == sorted(CLASSES)
        assert np.array_equal(masks["white sheet"], ring() > 0)
        assert not masks["hand"].any()
        assert labelled_frames(labels) == {"01": tuple(sorted(CLASSES))}

    def test_count_only_white(self, folder):
        file = folder / "bed/segmentations/01/white sheet.png"
        mask = np.where(ring() > 0, 255, 254).astype(np.uint8)
        Image.fromarray(mask).save(file)
        masks = read_labels(folder / "bed/segmentations", "01.jpg", WIDTH, HEIGHT)
        assert np.array_equal(masks["white sheet"], ring() > 0)

    @pytest.mark.parametrize(
        ("change", "sentence"),
        [
            (lambda f: (f / "01/hand.png").unlink(), r"hand\.png: no such mask; every labelled"),
            (lambda f: (f / "01/hand.png").write_text("no"), r"hand\.png: cannot be read"),
            (
                lambda f: Image.fromarray(ring() // 255).save(f / "01/hand.png"),
                "brightest pixel is 1",
            ),
            (lambda f: (f / "classes.txt").write_text(" \n"), r"classes\.txt: found \[\], expect"),
            (lambda f: (f / "classes.txt").write_text("hand\nhand"), r"classes\.txt: found"),
            (lambda f: (f / "classes.txt").write_bytes(b"\xff\xfe\x00"), r"classes\.txt: cannot"),
        ],
    )
    def test_that_are_damaged_are_named(self, folder, change, sentence):
        labels = folder / "bed/segmentations"
        change(labels)
        with pytest.raises(InputError, match=sentence):
            read_labels(labels, "01.jpg", WIDTH, HEIGHT)
