import numpy as np
import pytest

from slgaussian.masks.automatic import box_nms, mask_boxes, mostly_visible

SIZE = (40, 56)


def ellipses(count, seed, size=SIZE):
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]]
    centre = rng.uniform(0, 1, (count, 2)) * size
    radius = np.exp(rng.uniform(np.log(1.5), np.log(30), (count, 2)))
    at = [
        (g - c[:, None, None]) / r[:, None, None]
        for g, c, r in zip((rows, columns), centre.T, radius.T, strict=True)
    ]
    return at[0] ** 2 + at[1] ** 2 < 1


def hard(count=24, seed=5):
    """Identical, nested, full, empty and one-pixel masks, and nearly the same ones."""
    masks = ellipses(count, seed)
    masks[3] = masks[11] = masks[0]
    masks[4] = False
    masks[5] = False
    masks[5, 7, 9] = True
    masks[6] = masks[5]
    masks[7] = True
    masks[8] = masks[0]
    masks[8, :20] = False
    masks[9] = masks[0] | masks[10]
    masks[-1] = masks[0]
    masks[-1][np.nonzero(masks[0])[0][0]] = False
    return masks


def scores_of(masks, seed=0):
    """Few different ones, so that there are many ties."""
    return np.random.default_rng(seed).integers(0, 5, len(masks)) / 4


SETS = {
    "ellipses": ellipses(60, 1),
    "hard": hard(),
    "empty": np.zeros((9, *SIZE), bool),
    "one": np.ones((1, *SIZE), bool),
    "none": np.zeros((0, *SIZE), bool),
}


def plain_box_nms(boxes, scores, iou):
    indices = []
    for j in sorted(range(len(boxes)), key=lambda i: (-scores[i], i)):
        x0, y0, x1, y1 = map(int, boxes[j])
        for i in indices:
            u0, v0, u1, v1 = map(int, boxes[i])
            shared = max(0, min(x1, u1) - max(x0, u0)) * max(0, min(y1, v1) - max(y0, v0))
            union = (x1 - x0) * (y1 - y0) + (u1 - u0) * (v1 - v0) - shared
            if shared > iou * union:
                break
        else:
            indices.append(j)
    return indices


@pytest.mark.parametrize("iou", [0.0, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("name", SETS)
def test_boxes_as_pair_by_pair(name, iou):
    boxes, scores = mask_boxes(SETS[name]), scores_of(SETS[name])
    assert box_nms(boxes, scores, iou).tolist() == plain_box_nms(boxes, scores, iou)


@pytest.mark.parametrize("name", SETS)
def test_boxes_hold_their_masks_tightly(name):
    masks = SETS[name]
    for mask, (left, top, right, bottom) in zip(masks, mask_boxes(masks), strict=True):
        if not mask.any():
            assert (left, top, right, bottom) == (0, 0, 0, 0)
            continue
        inner = mask[top:bottom, left:right]
        assert inner.sum() == mask.sum()
        assert inner[0].any() and inner[-1].any() and inner[:, 0].any() and inner[:, -1].any()


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("share", [0.5, 0.8, 1.0])
def test_visible_as_pixel_by_pixel(name, share):
    masks = SETS[name]
    areas = masks.sum((1, 2))
    won = np.zeros(len(masks), int)
    for row, column in np.ndindex(SIZE):
        holders = np.flatnonzero(masks[:, row, column])
        if len(holders):
            won[min(holders, key=lambda i: (-areas[i], i))] += 1
    expected = [i for i in range(len(masks)) if areas[i] and won[i] >= share * areas[i]]
    assert mostly_visible(masks, share).tolist() == expected
