"""The lifting network against the paper, its file, and label filling from other views."""

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
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.training import compute_loss

# Not imported: an error in the module must show here.
REACH = 6.0

SMALL = Architecture(widths=(4, 6, 8), hidden=8)


def perturbed_branch(architecture: Architecture = SMALL, seed: int = 3) -> Branch:
    """Return a branch without zero weights, as after training."""
    branch = make_branch(architecture, seed)
    g = torch.Generator().manual_seed(seed)
    for parameter in branch.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=g)
    return branch.eval()


def make_bank(ids: np.ndarray, dimension: int = 3) -> MemoryBank:
    codes = np.random.default_rng(1).random((len(ids), dimension)).astype(np.float32)
    n = len(ids)
    return MemoryBank(ids, codes, np.zeros((n, 2, 1), np.float32), np.zeros((n, 2), bool))


def label_maps(labels: np.ndarray) -> LabelMaps:
    return LabelMaps(labels, np.ones(labels.shape, np.float32))


def reference_network(weights: dict[str, np.ndarray], codes: np.ndarray) -> np.ndarray:
    """Section 3.1 of the paper in float64: f [H, W, 3] of one code image M [3, H, W]."""

    def convolve(image, name, stride=1):
        kernel, shift = weights[f"{name}.weight"], weights[f"{name}.bias"]
        sums = [sum(map(correlate, image, channels)) for channels in kernel]
        return np.stack([s[::stride, ::stride] + b for s, b in zip(sums, shift, strict=True)])

    def correlate(image, kernel):
        return signal.correlate2d(image, kernel, "same")

    def halve(image):
        pads = [(0, 0), (0, image.shape[1] % 2), (0, image.shape[2] % 2)]
        quarters = np.pad(image, pads, constant_values=np.nan)
        quarters = [quarters[:, v::2, u::2] for v in (0, 1) for u in (0, 1)]
        return np.nanmean(quarters, axis=0)

    # A convolutional layer, then down-sampling by residual blocks ...
    x = np.maximum(convolve(codes, "stem"), 0)
    for block in range(2):
        inner = np.maximum(convolve(x, f"down.{block}.one", 2), 0)
        shortcut = convolve(halve(x), f"down.{block}.past")
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
def test_branch_equals_the_paper_in_float64(size):
    branch = make_branch(SMALL, 3).double()
    codes = np.random.default_rng(0).random((2, *size, 3))
    with torch.no_grad():
        features = branch(torch.from_numpy(codes)).numpy()
    weights = {name: weight.numpy() for name, weight in branch.state_dict().items()}
    expected = np.stack([reference_network(weights, image.transpose(2, 0, 1)) for image in codes])
    np.testing.assert_allclose(features[..., :3], expected, atol=1e-12)
    assert (features[..., 3] == 1).all()


def test_loss_equals_the_mean_squared_error():
    """Rendered codes against codes; unlabelled pixels are (0, 0, 0); no weight decay."""
    example = lesson()
    targets = example.targets.copy()
    targets[0, :6] = 0
    targets[1, 5:9, 3:8] = 9  # an object that no context view shows has a code as well
    example = replace(example, targets=targets)
    branch = make_branch(SMALL, 5)
    loss = compute_loss(branch, example, [0, 1], "grid", np.random.default_rng(2))
    maps = label_maps(np.concatenate([example.labels, targets]))
    codes = load_codes("grid")(maps, np.random.default_rng(2))
    bank = MemoryBank(maps.ids, codes, np.zeros((5, 2, 1), np.float32), np.zeros((5, 2), bool))
    features = BranchLifting(branch)(example.gaussians, label_maps(example.labels), bank).features
    errors = []
    for camera, target in zip(example.cameras, targets, strict=True):
        expected = np.append([[0, 0, 0]], codes, axis=0)[np.searchsorted(maps.ids, target) + 1]
        expected[target == 0] = 0
        values = rasterize(example.gaussians, features, camera).values[..., :3].numpy()
        errors.append(values - expected)
    assert float(loss.detach()) == pytest.approx(np.mean(np.square(errors)), rel=1e-5)
    # What is rendered where the photograph of a target is transparent is no error.
    opaque = targets > 0
    partly = replace(example, opaque=opaque)
    loss = compute_loss(branch, partly, [0, 1], "grid", np.random.default_rng(2))
    known = np.mean(np.square(errors) * opaque[..., None])
    assert known < np.mean(np.square(errors))
    assert float(loss.detach()) == pytest.approx(known, rel=1e-5)
    assert np.array_equal(Lesson.from_arrays(partly.to_arrays()).opaque, opaque)


def test_make_branch_depends_on_the_seed_only():
    state = torch.random.get_rng_state()
    first, same, different = (save_branch(make_branch(SMALL, seed)) for seed in (1, 1, 2))
    assert torch.equal(torch.random.get_rng_state(), state)
    assert first == same != different


def test_load_branch_restores_the_lifting(tmp_path):
    branch, example = perturbed_branch(), lesson()
    (tmp_path / "b.safetensors").write_bytes(save_branch(branch))
    maps = label_maps(example.labels)
    bank = make_bank(maps.ids)
    loaded = load_lifting("branch", weights=tmp_path / "b.safetensors")
    expected = BranchLifting(branch)(example.gaussians, maps, bank).features
    assert torch.equal(loaded(example.gaussians, maps, bank).features, expected)
    assert expected.shape == (len(example.gaussians), 4)


def test_load_branch_refuses_invalid_weights(tmp_path):
    with pytest.raises(InputError, match="no weights are given; train some"):
        load_lifting("branch")
    file, weights = tmp_path / "b.safetensors", save_branch(perturbed_branch())
    tensors = safetensors.torch.load(weights)
    metadata = {"slgaussian": json.dumps({"architecture": {"widths": [4, 6, 8], "hidden": 16}})}
    for content, message in (
        (None, "cannot be read"),
        (b"", "cannot be read"),
        (b"no weights at all", "cannot be read"),
        (weights[:-10], "cannot be read"),
        (safetensors.torch.save(tensors, metadata), "tensors are not those of the architecture"),
        (safetensors.torch.save(tensors), "does not say which branch"),
    ):
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(InputError, match=f"weights {file}: {message}"):
            load_branch(file)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_fill_from_other_views_equals_a_full_search(seed, views):
    rng = np.random.default_rng(seed)
    shape, n = (views, 4, 5), rng.integers(0, 40)
    gaussians = Gaussians(
        means=torch.from_numpy(rng.normal(0, 0.3, (n, 3)).astype(np.float32)),
        scales=torch.from_numpy(rng.uniform(0.01, 0.2, (n, 3)).astype(np.float32)),
        quats=torch.ones(n, 4),
        opacities=torch.ones(n),
        sh=torch.zeros(n, 0, 3),
        source=torch.from_numpy(rng.integers(0, 20 * views, n).astype(np.int32)),
    )
    labels = rng.integers(0, 4, shape).astype(np.int32)
    before, expected = labels.copy(), labels.copy()
    means = gaussians.means.numpy().astype(np.float64)
    owners, firsts = np.unique(gaussians.source.numpy(), return_index=True)
    for pixel, first in zip(owners, firsts, strict=True):
        in_other_views = owners // 20 != pixel // 20
        if labels.ravel()[pixel] == 0 and in_other_views.any():
            distances = np.linalg.norm(means[firsts[in_other_views]] - means[first], axis=1)
            if distances.min() < REACH * gaussians.scales[first].max():
                nearest = owners[in_other_views][distances.argmin()]
                expected.ravel()[pixel] = labels.ravel()[nearest]
    np.testing.assert_array_equal(fill_from_other_views(labels, gaussians), expected)
    np.testing.assert_array_equal(labels, before)


def test_filled_lifting_labels_pixels_from_the_other_view():
    example = lesson()
    gaussians, labels = example.gaussians, example.labels.copy()
    labels[0, 5:9, 10:20] = 0
    maps, bank = label_maps(labels), make_bank(np.unique(example.labels))
    complete, incomplete = (
        HardIndex()(gaussians, m, bank).features for m in (label_maps(example.labels), maps)
    )
    filled = load_lifting("filled")(gaussians, maps, bank).features
    hole = (labels == 0).ravel()
    assert torch.equal(filled[~hole], incomplete[~hole])
    assert torch.equal(filled[hole], complete[hole])  # the other view sees each of these pixels
    one_view = gaussians[gaussians.source < 24 * 32]
    unfilled = load_lifting("filled")(one_view, maps, bank).features
    assert torch.equal(unfilled, HardIndex()(one_view, maps, bank).features)


def test_branch_lifting_gives_equal_bytes_on_any_number_of_threads():
    example, before = lesson(size=(64, 64)), torch.get_num_threads()
    maps = label_maps(example.labels)
    lifting = BranchLifting(perturbed_branch(Architecture()))
    features = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            features.append(lifting(example.gaussians, maps, make_bank(maps.ids)).features)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*features)
