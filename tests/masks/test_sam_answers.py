"""What SAM must find: what random weights say of it, and what one that finds it says."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy import ndimage

pytest.importorskip("transformers")

from small_models import save_sam, save_sam2

from slgaussian.masks import sam_answers
from slgaussian.masks.sam import Sam
from slgaussian.masks.sam2 import Sam2

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.parametrize(("save", "part"), [(save_sam, Sam), (save_sam2, Sam2)])
def test_random_weights_compute_rightly_and_find_nothing(save, part, tmp_path):
    found = {f.said.split(":")[0]: f for f in sam_answers.findings(part(save(tmp_path)))}
    assert {f.name for f in found.values()} == {part.FAMILY.part}
    assert found["masks"].good is True and "gives the same masks" in found["masks"].said
    assert found["disc"].good is False
    assert found["disc"].said.endswith("expected 0.8; are these weights random or damaged?")
    assert found["cost"].good is None and "16 x 16 points" in found["cost"].said


class Flooded:
    """An image whose masks are what joins the point in one colour."""

    def __init__(self, image, proposer):
        self.smooth, self.proposer = (
            ndimage.gaussian_filter(image.astype(float), (2, 2, 0)),
            proposer,
        )

    def segment(self, points):
        masks = []
        for x, y in points.astype(int):
            if self.proposer.same_point:
                x, y = sam_answers.drawn_disc(self.smooth.shape[:2])[2]
            near = np.abs(self.smooth - self.smooth[y, x]).sum(2) < 60
            pieces, _ = ndimage.label(near)
            masks.append(pieces == pieces[y, x])
        logits = torch.from_numpy(np.where(masks, 1.0, -1.0)).float()[:, None].repeat(1, 3, 1, 1)
        self.proposer.asked += 1
        return logits + self.proposer.drift * self.proposer.asked, torch.full((len(masks), 3), 0.9)

    def enlarge(self, logits):
        return logits


class Flood:
    """A proposer that finds discs without a network."""

    FAMILY = SimpleNamespace(part="flood")
    batch = 4

    def __init__(self, drift=0.0, same_point=False):
        self.drift, self.same_point, self.asked = drift, same_point, 0
        self.network = torch.nn.Linear(1, 1)

    def encode(self, image):
        return Flooded(image, self)


def said_of(proposer):
    return {f.said.split(":")[0]: f for f in sam_answers.findings(proposer)}


def test_one_that_finds_discs_passes():
    found = said_of(Flood())
    assert [found[name].good for name in ("masks", "disc", "point")] == [True] * 3
    assert "random" not in "".join(finding.said for finding in found.values())


def test_one_that_heeds_no_prompt_is_named():
    found = said_of(Flood(same_point=True))
    assert found["disc"].good is True
    assert found["point"].good is False and "does not heed its prompt" in found["point"].said


def test_one_that_drifts_or_gives_no_numbers_is_named():
    found = said_of(Flood(drift=0.9))
    assert found["masks"].good is False and "twice gives other masks" in found["masks"].said
    (only,) = sam_answers.findings(Flood(drift=float("nan")))
    assert only.good is False and "hold NaN or infinity" in only.said


def test_the_disc_lies_in_its_image_with_a_point_in_it_and_one_beside():
    for size in sam_answers.SIZES:
        image, disc, (x, y), outer = sam_answers.drawn_disc(size)
        assert image.shape == (*size, 3) and disc.shape == size and image.dtype == np.uint8
        assert disc[y, x] and not disc[int(outer[1]), int(outer[0])]
        edges = np.concatenate([disc[0], disc[-1], disc[:, 0], disc[:, -1]])
        assert not edges.any()
        assert image[disc].mean(0)[0] > image[~disc].mean(0)[0] + 80
