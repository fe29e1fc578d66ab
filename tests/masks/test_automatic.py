"""The generator on an "encoder" that knows the drawn objects, so that the right masks are known."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from slgaussian.masks.automatic import all_masks, mostly_visible
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


def test_all_masks_returns_each_nested_box_once():
    result = all_masks(Drawn(), picture(), PLAIN)
    assert sorted(names(result)) == ["group", "object", "part"]
    # The box of the object covers .4 of that of the group.
    at_lower_iou = all_masks(Drawn(), picture(), replace(PLAIN, box_iou=0.3))
    assert sorted(names(at_lower_iou)) == ["group", "part"]
    assert result.scores.dtype == np.float32 and (np.diff(result.scores) <= 0).all()


def test_all_masks_returns_only_masks_of_given_levels():
    assert names(all_masks(Drawn(), picture(), PLAIN, levels=("l",))) == ["group"]
    assert sorted(names(all_masks(Drawn(), picture(), PLAIN, levels=("m",)))) == ["group", "object"]


def test_all_masks_drops_masks_of_low_iou_or_stability():
    assert len(all_masks(Drawn(), picture(), replace(PLAIN, predicted_iou=0.95)).masks) == 0
    some = replace(PLAIN, predicted_iou=0.92)  # the third mask has .85, the second .9
    assert len(all_masks(Drawn(), picture(), some, levels=("m", "l")).masks) == 0
    # Logits of 0.5 all over: cut at +1 nothing is left.
    assert len(all_masks(Drawn(steep=0.5), picture(), PLAIN).masks) == 0
    assert len(all_masks(Drawn(steep=0.5), picture(), replace(PLAIN, stability=0)).masks) == 3


def test_all_masks_prompts_only_points_in_region():
    drawn = Drawn()
    place = np.zeros(SIZE, bool)
    place[:, 64:] = True
    assert names(all_masks(drawn, picture(), PLAIN, place)) == ["group"]
    points = np.concatenate(drawn.points)
    assert len(points) == 32 and (points[:, 0] >= 64).all()
    nowhere = Drawn()
    result = all_masks(nowhere, picture(), PLAIN, np.zeros(SIZE, bool))
    assert nowhere.encoded == 0
    assert result.masks.shape == (0, *SIZE) and len(result.scores) == 0


def test_presets_yield_masks_and_grouping_drops_hidden_ones():
    assert set(PRESETS) == {"sam", "sam2", "grouping"}
    for settings in PRESETS.values():
        assert len(all_masks(Drawn(), picture(), replace(settings, points=8)).masks) >= 1
    # Gaussian Grouping: parts go.
    assert names(all_masks(Drawn(), picture(), replace(PRESETS["grouping"], points=8))) == ["group"]


def ellipses(count, seed):
    rng = np.random.default_rng(seed)
    at = np.stack(np.mgrid[:40, :56], -1)
    centre = rng.uniform(0, 1, (count, 1, 1, 2)) * (40, 56)
    radius = np.exp(rng.uniform(np.log(1.5), np.log(30), (count, 1, 1, 2)))
    return (((at - centre) / radius) ** 2).sum(-1) < 1


def hard():
    """Identical, nested, full, empty and one-pixel masks."""
    masks = ellipses(24, 5)
    masks[3] = masks[11] = masks[0]
    masks[4] = masks[5] = False
    masks[5, 7, 9] = masks[7] = True
    masks[8] = masks[0]
    masks[8, :20] = False
    return masks


@pytest.mark.parametrize("share", [0.5, 0.8, 1.0])
@pytest.mark.parametrize(
    "masks",
    [ellipses(60, 1), hard(), np.zeros((9, 40, 56), bool), np.zeros((0, 40, 56), bool)],
    ids=["ellipses", "hard", "empty", "none"],
)
def test_mostly_visible_equals_count_pixel_by_pixel(masks, share):
    areas = masks.sum((1, 2))
    won = np.zeros(len(masks), int)
    for row, column in np.ndindex(masks.shape[1:]):
        holders = np.flatnonzero(masks[:, row, column])
        if len(holders):
            won[min(holders, key=lambda i: (-areas[i], i))] += 1
    expected = [i for i in range(len(masks)) if areas[i] and won[i] >= share * areas[i]]
    assert mostly_visible(masks, share).tolist() == expected
