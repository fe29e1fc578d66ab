"""The network is wired as printed, and stored safely; ``filled`` fills from other views."""

import json
from dataclasses import replace

import numpy as np
import pytest
import safetensors.torch
import torch
from drawn_lessons import lesson
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, signal

from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes
from slgaussian.language.bank import MemoryBank
from slgaussian.rasterize import rasterize
from slgaussian.semantic import load_lifting
from slgaussian.semantic.branch import (
    Architecture,
    Branch,
    BranchLifting,
    load_branch,
    make_branch,
    save_branch,
)
from slgaussian.semantic.hard import HardIndex, fill_from_other_views
from slgaussian.semantic.training import loss_of

# Written out, not imported: a slip in the module must show here.
REACH = 6.0

SMALL = Architecture(widths=(4, 6, 8), hidden=8)


def shaken(architecture: Architecture = SMALL, seed: int = 3) -> Branch:
    """With no weight zero, as after training."""
    branch = make_branch(architecture, seed)
    g = torch.Generator().manual_seed(seed)
    for parameter in branch.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=g)
    return branch.eval()


def bank_of(ids: np.ndarray, dimension: int = 3) -> MemoryBank:
    codes = np.random.default_rng(1).random((len(ids), dimension)).astype(np.float32)
    n = len(ids)
    return MemoryBank(ids, codes, np.zeros((n, 2, 1), np.float32), np.zeros((n, 2), bool))


def label_maps(labels: np.ndarray) -> LabelMaps:
    return LabelMaps(labels, np.ones(labels.shape, np.float32))


def printed(weights: dict[str, np.ndarray], codes: np.ndarray) -> np.ndarray:
    """Section 3.1 in words, float64: f [H, W, 3] of one code image M [3, H, W]."""

    def convolve(image, name, stride=1):
        kernel, shift = weights[f"{name}.weight"], weights[f"{name}.bias"]
        sums = [sum(map(correlate, image, channels)) for channels in kernel]
        return np.stack([s[::stride, ::stride] + b for s, b in zip(sums, shift, strict=True)])

    def correlate(image, kernel):
        return signal.correlate2d(image, kernel, "same")

    def halved(image):
        pads = [(0, 0), (0, image.shape[1] % 2), (0, image.shape[2] % 2)]
        quarters = np.pad(image, pads, constant_values=np.nan)
        quarters = [quarters[:, v::2, u::2] for v in (0, 1) for u in (0, 1)]
        return np.nanmean(quarters, axis=0)

    # First a convolutional layer, then down-sampling by residual blocks ...
    x = np.maximum(convolve(codes, "stem"), 0)
    for block in range(2):
        inner = np.maximum(convolve(x, f"down.{block}.one", 2), 0)
        shortcut = convolve(halved(x), f"down.{block}.past")
        x = np.maximum(shortcut + convolve(inner, f"down.{block}.two"), 0)
    # ... up-sampled to the original resolution, added to M, and an MLP to three numbers.
    coarse, (height, width) = convolve(x, "up"), codes.shape[1:]
    rows, columns = (
        np.clip((np.arange(size) + 0.5) * small / size - 0.5, 0, small - 1)
        for size, small in ((height, coarse.shape[1]), (width, coarse.shape[2]))
    )
    grid = np.meshgrid(rows, columns, indexing="ij")
    fine = np.stack([ndimage.map_coordinates(c, grid, order=1) for c in coarse])
    hidden = np.maximum(convolve(codes + fine, "first"), 0)
    return convolve(hidden, "last").transpose(1, 2, 0)


@pytest.mark.parametrize("size", [(24, 32), (17, 5), (9, 14)])
def test_the_printed_network_is_wired_as_printed(size):
    branch = make_branch(SMALL, 3).double()
    codes = np.random.default_rng(0).random((2, *size, 3))
    with torch.no_grad():
        features = branch(torch.from_numpy(codes)).numpy()
    weights = {name: weight.numpy() for name, weight in branch.state_dict().items()}
    expected = np.stack([printed(weights, image.transpose(2, 0, 1)) for image in codes])
    np.testing.assert_allclose(features[..., :3], expected, atol=1e-12)
    assert (features[..., 3] == 1).all()


def test_the_printed_loss_is_the_plain_mean_over_all_pixels():
    """Rendered codes against codes, unknown pixels (0, 0, 0), and no part for the weights."""
    mine = lesson()
    targets = mine.targets.copy()
    targets[0, :6] = 0
    targets[1, 5:9, 3:8] = 9  # an object that no context view shows has a code as well
    mine = replace(mine, targets=targets)
    branch = make_branch(SMALL, 5)
    loss = loss_of(branch, mine, [0, 1], "grid", np.random.default_rng(2))
    maps = label_maps(np.concatenate([mine.labels, targets]))
    codes = load_codes("grid")(maps, np.random.default_rng(2))
    bank = MemoryBank(maps.ids, codes, np.zeros((5, 2, 1), np.float32), np.zeros((5, 2), bool))
    features = BranchLifting(branch)(mine.gaussians, label_maps(mine.labels), bank).features
    errors = []
    for camera, target in zip(mine.cameras, targets, strict=True):
        wanted = np.zeros((*target.shape, 3))
        for ident, code in zip(maps.ids, codes, strict=True):
            wanted[target == ident] = code
        errors.append(rasterize(mine.gaussians, features, camera).values[..., :3].numpy() - wanted)
    assert float(loss.detach()) == pytest.approx(np.mean(np.square(errors)), rel=1e-5)


def test_the_same_seed_makes_the_same_weights_and_leaves_torch_alone():
    state = torch.random.get_rng_state()
    one, same, other = make_branch(SMALL, 1), make_branch(SMALL, 1), make_branch(SMALL, 2)
    assert torch.equal(torch.random.get_rng_state(), state)
    assert save_branch(one) == save_branch(same) != save_branch(other)


def test_a_stored_branch_lifts_as_before(tmp_path):
    branch, mine = shaken(), lesson()
    (tmp_path / "b.safetensors").write_bytes(save_branch(branch))
    maps = label_maps(mine.labels)
    bank = bank_of(maps.ids)
    loaded = load_lifting("branch", weights=tmp_path / "b.safetensors")
    before = BranchLifting(branch)(mine.gaussians, maps, bank).features
    assert torch.equal(loaded(mine.gaussians, maps, bank).features, before)
    assert before.shape == (len(mine.gaussians), 4)


def test_a_file_that_is_no_weights_is_refused(tmp_path):
    with pytest.raises(InputError, match="no weights are given; train some"):
        load_lifting("branch")
    file, weights = tmp_path / "b.safetensors", save_branch(shaken())
    tensors = safetensors.torch.load(weights)
    about = {"slgaussian": json.dumps({"architecture": {"widths": [4, 6, 8], "hidden": 16}})}
    for content, sentence in (
        (None, "cannot be read"),
        (b"", "cannot be read"),
        (b"no weights at all", "cannot be read"),
        (weights[:-10], "cannot be read"),
        (safetensors.torch.save(tensors, about), "tensors are not those of the architecture"),
        (safetensors.torch.save(tensors), "does not say which branch"),
    ):
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(InputError, match=f"weights {file}: {sentence}"):
            load_branch(file)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_labels_come_from_the_nearest_within_reach(seed, views):
    """Against all distances."""
    rng = np.random.default_rng(seed)
    shape, n = (views, 4, 5), rng.integers(0, 40)
    made = Gaussians(
        means=torch.from_numpy(rng.normal(0, 0.3, (n, 3)).astype(np.float32)),
        scales=torch.from_numpy(rng.uniform(0.01, 0.2, (n, 3)).astype(np.float32)),
        quats=torch.ones(n, 4),
        opacities=torch.ones(n),
        sh=torch.zeros(n, 0, 3),
        source=torch.from_numpy(rng.integers(0, 20 * views, n).astype(np.int32)),
    )
    labels = rng.integers(0, 4, shape).astype(np.int32)
    before, wanted = labels.copy(), labels.copy()
    means = made.means.numpy().astype(np.float64)
    owners, firsts = np.unique(made.source.numpy(), return_index=True)
    for pixel, first in zip(owners, firsts, strict=True):
        theirs = owners // 20 != pixel // 20
        if labels.ravel()[pixel] == 0 and theirs.any():
            far = np.linalg.norm(means[firsts[theirs]] - means[first], axis=1)
            if far.min() < REACH * made.scales[first].max():
                wanted.ravel()[pixel] = labels.ravel()[owners[theirs][far.argmin()]]
    np.testing.assert_array_equal(fill_from_other_views(labels, made), wanted)
    np.testing.assert_array_equal(labels, before)


def test_what_one_view_lacks_is_filled_from_the_other_and_nothing_else_changes():
    mine = lesson()
    labels = mine.labels.copy()
    labels[0, 5:9, 10:20] = 0
    bank = bank_of(np.unique(mine.labels))
    whole, holed = (HardIndex()(mine.gaussians, label_maps(m), bank) for m in (mine.labels, labels))
    filled = load_lifting("filled")(mine.gaussians, label_maps(labels), bank).features
    hole = (labels == 0).ravel()
    assert torch.equal(filled[~hole], holed.features[~hole])
    assert torch.equal(filled[hole], whole.features[hole])  # these the other view sees, to a pixel
    alone = mine.gaussians[mine.gaussians.source < 24 * 32]
    unfilled = load_lifting("filled")(alone, label_maps(labels), bank).features
    assert torch.equal(unfilled, HardIndex()(alone, label_maps(labels), bank).features)


def test_bytes_do_not_depend_on_the_thread_count():
    mine, before = lesson(size=(64, 64)), torch.get_num_threads()
    maps = label_maps(mine.labels)
    bank = bank_of(maps.ids)
    found = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(BranchLifting(shaken(Architecture()))(mine.gaussians, maps, bank).features)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*found)
