"""Files in the layouts of programs that predict depth and cameras, written from exact ones."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from slgaussian.scene import View

PATCH = 14
"""Sides of a network's input are multiples of it, pixels."""


def network_input(view: View) -> tuple[np.ndarray, np.ndarray]:
    """Return depth float32 [h, w] and K of a view, stretched to the input of a network."""
    width, height = (round(n / PATCH) * PATCH for n in (view.camera.width, view.camera.height))
    depth = cv2.resize(view.depth, (width, height), interpolation=cv2.INTER_NEAREST)
    stretch = np.diag([width / view.camera.width, height / view.camera.height, 1])
    return depth.astype(np.float32), stretch @ view.camera.K


def write_pfm(file: Path, depth: np.ndarray) -> None:
    """Write float32 [h, w] as little-endian PFM, whose lowest row comes first."""
    head = f"Pf\n{depth.shape[1]} {depth.shape[0]}\n-1.0\n".encode()
    file.write_bytes(head + depth[::-1].astype("<f4").tobytes())


def write_da3_cli(folder: Path, views: Sequence[View], prefix: str = "out") -> Path:
    """Write what ``da3-cli depth --input A --input B --out-prefix PREFIX`` does.

    That is a PFM, an 8-bit picture and a JSON of 8 digits a number for each view, as in
    ``examples/cli/main.cpp``, ``src/depth_export.cpp`` and ``src/pose_export.cpp`` of
    https://github.com/mudler/depth-anything.cpp.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for number, view in enumerate(views):
        depth, K = network_input(view)
        write_pfm(folder / f"{prefix}_view{number}.pfm", depth)
        grey = 255 * (1 - (depth - depth.min()) / np.ptp(depth))
        Image.fromarray(grey.astype(np.uint8)).save(folder / f"{prefix}_view{number}.png")
        rows = [
            ",\n".join("    [" + ", ".join(f"{x:.8g}" for x in row) + "]" for row in matrix)
            for matrix in (view.camera.w2c[:3], K)
        ]
        text = '{{\n  "extrinsics": [\n{}\n  ],\n  "intrinsics": [\n{}\n  ]\n}}\n'.format(*rows)
        (folder / f"{prefix}_view{number}.json").write_text(text)
    return folder


def write_predictions(file: Path, views: Sequence[View], family: str) -> Path:
    """Write the NPZ that ``make_predictions_npz.py`` makes of what ``vggt-cli`` wrote.

    The ``vggt`` family has intrinsics, ``mapanything`` and Pi3 have none
    (https://github.com/Asher-1/map-anything-ggml, ``cpp_ggml/scripts``).
    """
    depth, K = (np.array(values) for values in zip(*map(network_input, views), strict=True))
    w2c, c2w = (np.array([getattr(view.camera, a) for view in views]) for a in ("w2c", "c2w"))
    rows, columns = np.indices(depth.shape[1:]) + 0.5
    pixels = np.stack([columns, rows, np.ones(rows.shape)], -1)
    local = np.einsum("vij,hwj->vhwi", np.linalg.inv(K), pixels) * depth[..., None]
    world = np.einsum("vij,vhwj->vhwi", c2w[:, :3, :3], local) + c2w[:, None, None, :3, 3]
    conf, extrinsic = np.full(depth.shape, 2, np.float32), w2c[:, :3].astype(np.float32)
    if family == "vggt":
        arrays = {"pose_enc": np.zeros((len(views), 9), np.float32), "depth_conf": conf}
        arrays |= {"intrinsic": K.astype(np.float32), "world_points_from_depth": world}
    else:
        arrays = {"pose_c2w": c2w.astype(np.float32), "conf": conf, "local_points": local}
        arrays |= {"world_points": world, "metric_scaling_factor": 1.5}
    np.savez(file, depth=depth[..., None], extrinsic=extrinsic, **arrays)
    return file
