"""The generator on an "encoder" that knows the drawn objects, so that the right masks are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from slgaussian.masks.automatic import all_masks, crop_boxes, tidy
from slgaussian.masks.configs import PRESETS, Automatic

SIZE = (96, 128)
BOXES = {"group": (8, 8, 88, 80), "object": (16, 16, 64, 64), "part": (24, 24, 48, 48)}


pytestmark = pytest.mark.usefixtures("one_thread")


def picture():
    """Nested grey boxes on black; the grey level is the depth of nesting."""
    image = np.zeros((*SIZE, 3), np.uint8)
    for level, (top, left, bottom, right) in enumerate(BOXES.values(), start=1):
        image[top:bottom, left:right] = 60 * level
    return image


class Drawn:
    """Answers a point with the part, the object and the group of boxes that it lies in.

    Logits are at half the size, steep where ``steep``; predicted IoU falls with the level.
    """

    calls = 0
    encoded = 0

    def __init__(self, steep=9.0, predicted=(0.95, 0.9, 0.85)):
        self.steep, self.predicted = steep, predicted
        self.points = []

    def __call__(self, image):
        self.encoded += 1
        return _DrawnImage(self, image)


class _DrawnImage:
    def __init__(self, drawn, image):
        self.drawn, self.grey = drawn, torch.from_numpy(image[..., 0].astype(np.float32))

    def segment(self, points):
        self.drawn.points.append(points)
        out = []
        for x, y in points:
            grey = float(self.grey[int(y), int(x)])
            masks = [self.grey >= max(1, min(grey, 60 * n)) for n in (3, 2, 1)]
            out.append(torch.stack([torch.where(m, 1.0, -1.0) * self.drawn.steep for m in masks]))
        return torch.stack(out), torch.tensor([self.drawn.predicted] * len(points))

    def enlarge(self, logits):
        return logits


def box_mask(name):
    mask = np.zeros(SIZE, bool)
    top, left, bottom, right = BOXES[name]
    mask[top:bottom, left:right] = True
    return mask


def names(proposals):
    result = []
    for mask in proposals.masks:
        result += [name for name in BOXES if np.array_equal(mask, box_mask(name))]
    assert len(result) == len(proposals.masks)
    return result


PLAIN = Automatic(points=8, predicted_iou=0.8, stability=0.9)


def test_nested_boxes_are_found_once_each():
    result = all_masks(Drawn(), picture(), PLAIN)
    assert sorted(names(result)) == ["group", "object", "part"]
    assert result.scores.dtype == np.float32 and (np.diff(result.scores) <= 0).all()


def test_levels_are_kept_apart_or_not():
    gap = all_masks(Drawn(), picture(), replace(PLAIN, apart=True))
    assert sorted(zip(gap.levels.tolist(), names(gap), strict=True)) == [
        (0, "group"), (0, "object"), (0, "part"), (1, "group"), (1, "object"), (2, "group"),
    ]  # fmt: skip
    assert names(all_masks(Drawn(), picture(), PLAIN, levels=("l",))) == ["group"]
    large = all_masks(Drawn(), picture(), replace(PLAIN, apart=True), levels=("m",))
    assert sorted(names(large)) == ["group", "object"] and set(large.levels) == {1}


def test_what_is_not_sure_or_not_stable_goes():
    assert len(all_masks(Drawn(), picture(), replace(PLAIN, predicted_iou=0.95)).masks) == 0
    result = all_masks(Drawn(), picture(), replace(PLAIN, predicted_iou=0.92))
    assert set(result.levels) == {0}
    # Logits of 0.5 all over: cut at +1 nothing is left.
    assert len(all_masks(Drawn(steep=0.5), picture(), PLAIN).masks) == 0
    assert len(all_masks(Drawn(steep=0.5), picture(), replace(PLAIN, stability=0)).masks) == 3
    assert len(all_masks(Drawn(), picture(), replace(PLAIN, score=0.9)).masks) == 3
    assert len(all_masks(Drawn(), picture(), replace(PLAIN, score=0.96)).masks) == 0


def test_where_limits_the_points():
    drawn = Drawn()
    place = np.zeros(SIZE, bool)
    place[:, 64:] = True
    assert names(all_masks(drawn, picture(), PLAIN, place)) == ["group"]
    points = np.concatenate(drawn.points)
    assert len(points) == 32 and (points[:, 0] >= 64).all()
    nowhere = Drawn()
    result = all_masks(nowhere, picture(), PLAIN, np.zeros(SIZE, bool))
    assert nowhere.encoded == 0
    assert result.masks.shape == (0, *SIZE) and len(result.scores) == len(result.levels) == 0


@pytest.mark.parametrize("size", [(96, 128), (720, 960), (5, 300), (1, 1)])
def test_crops_cover_the_image_and_overlap(size):
    boxes = list(crop_boxes(*size, 2))
    assert boxes[0] == (0, 0, size[1], size[0]) and len(boxes) == 1 + 4 + 16
    for layer in (boxes[1:5], boxes[5:]):
        covered = np.zeros(size, int)
        for left, top, right, bottom in layer:
            assert 0 <= left < right <= size[1] and 0 <= top < bottom <= size[0]
            covered[top:bottom, left:right] += 1
        assert (covered > 0).all()
        if min(size) > 50:
            assert covered.max() == 4
    if size == (720, 960):  # an overlap of 512 / 1500 of 720 is 245, so crops are 603 wide
        assert boxes[1:5] == [
            (0, 0, 603, 483), (357, 0, 960, 483), (0, 237, 603, 720), (357, 237, 960, 720),
        ]  # fmt: skip


def test_crops_show_what_is_whole_in_them():
    image = np.zeros((192, 256, 3), np.uint8)
    image[60:140, 30:226] = 60  # cut by every crop of the first layer
    image[30:50, 40:60] = 180
    plain = all_masks(Drawn(), image, PLAIN)
    drawn = Drawn()
    cropped = all_masks(drawn, image, replace(PLAIN, crops=1))
    assert drawn.encoded == 5
    assert sorted(m.sum() for m in cropped.masks) == sorted(m.sum() for m in plain.masks)


def test_presets_are_those_of_the_programs():
    assert set(PRESETS) == {"sam", "sam2", "langsplat", "grouping"}
    for settings in PRESETS.values():
        small = replace(settings, points=8, smallest=0)
        result = all_masks(Drawn(), picture(), small)
        assert len(result.masks) >= 1
    # LangSplat: inside each level a mask inside another one goes; Gaussian Grouping: parts go.
    nested = all_masks(Drawn(), picture(), replace(PRESETS["langsplat"], points=8, crops=0))
    assert sorted(zip(nested.levels.tolist(), names(nested), strict=True)) == [
        (0, "group"), (1, "group"), (2, "group"),
    ]  # fmt: skip
    assert names(all_masks(Drawn(), picture(), replace(PRESETS["grouping"], points=8))) == ["group"]


def plain_tidy(mask, smallest):
    """Pixel by pixel: holes first, then islands."""
    mask = mask.copy()
    for value in (False, True):
        view, groups = np.zeros(mask.shape, bool), []
        for start in zip(*np.nonzero(mask == value), strict=True):
            if view[start]:
                continue
            group, todo = [], [start]
            view[start] = True
            while todo:
                row, column = todo.pop()
                group.append((row, column))
                for r in range(max(0, row - 1), min(mask.shape[0], row + 2)):
                    for c in range(max(0, column - 1), min(mask.shape[1], column + 2)):
                        if mask[r, c] == value and not view[r, c]:
                            view[r, c] = True
                            todo.append((r, c))
            groups.append(group)
        small = [group for group in groups if len(group) < smallest]
        if value and len(small) == len(groups) > 0:
            small.remove(max(groups, key=len))
        for group in small:
            for at in group:
                mask[at] = not value
    return mask


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("smallest", [1, 6, 40, 9999])
def test_tidy_as_pixel_by_pixel(seed, smallest):
    noise = np.random.default_rng(seed).standard_normal((30, 41)).astype(np.float32)
    mask = cv2.GaussianBlur(noise, (0, 0), 1.2) > 0.1
    expected = plain_tidy(mask, smallest)
    changed = not np.array_equal(mask, expected)
    assert tidy(mask, smallest) == changed
    np.testing.assert_array_equal(mask, expected)
