"""Reference outputs of the published implementation, and a network with the same weights."""

from pathlib import Path

import numpy as np
import pytest
import torch

from benches.predict.random_mvsplat_weights import recipe_weights
from slgaussian.predict.mvsplat.checkpoint import load_network
from slgaussian.predict.mvsplat.network import Network
from slgaussian.scene import Camera


@pytest.fixture(autouse=True)
def all_here(one_thread) -> None:
    """Skip the tests of this folder without the reference."""


@pytest.fixture(scope="session")
def weights() -> dict[str, torch.Tensor]:
    return recipe_weights()


@pytest.fixture(scope="session")
def checkpoint(weights, tmp_path_factory) -> Path:
    """As published: in a Lightning checkpoint, beside what is not the encoder's."""
    path = tmp_path_factory.mktemp("mvsplat") / "recipe.ckpt"
    state = {f"encoder.{name}": value for name, value in weights.items()}
    state["losses.lpips.weight"] = torch.zeros(3)
    torch.save({"epoch": 7, "state_dict": state, "optimizer_states": [{"lr": 2e-4}]}, path)
    return path


@pytest.fixture(scope="session")
def network(checkpoint) -> Network:
    return load_network(checkpoint)


@pytest.fixture(scope="session")
def reference() -> dict[str, np.ndarray]:
    return dict(np.load(Path(__file__).with_name("reference.npz")))


@pytest.fixture(scope="session")
def cameras(reference) -> list[Camera]:
    """Return the cameras of the reference's two views."""
    size = reference["input/image"].shape[-1]
    pixels = np.diag([size, size, 1.0])
    matrices = zip(reference["input/intrinsics"], reference["input/extrinsics"], strict=True)
    return [Camera(pixels @ K, c2w, size, size) for K, c2w in matrices]
