"""Small valid sets of files of every format that is read, to damage them one at a time."""

from __future__ import annotations

import gzip
import json
import random
import shutil
import struct
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import plyfile
import pyarrow as pa
import torch
from PIL import ExifTags, Image

from slgaussian.benchmark.annotations import labelled_frames, read_labels
from slgaussian.benchmark.index import Index, ScenePair, read_index, write_index
from slgaussian.datasets import colmap, llff, nerfstudio, re10k, unposed
from slgaussian.datasets.sharpness import glance
from slgaussian.errors import InputError, SLGaussianError
from slgaussian.field import SemanticField
from slgaussian.formats.ply import load_ply, save_ply
from slgaussian.formats.spz import load_spz, save_spz
from slgaussian.gaussians import Gaussians
from slgaussian.language import load_encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.masks.precomputed import read_ids
from slgaussian.predict.mvsplat.checkpoint import read_state
from slgaussian.scene import Camera, Scene, View
from slgaussian.semantic.branch import Architecture, Branch, load_branch, make_branch, save_branch
from slgaussian.semantic.checkpoints import load_checkpoint, save_checkpoint
from slgaussian.semantic.versions import Versions
from slgaussian.storage.encoding import decode_arrays, decode_table, encode_arrays, encode_table
from slgaussian.storage.specs import load_spec
from tests import pinhole
from tests.damaged_bytes import damage

W, H = 48, 32


@dataclass(frozen=True)
class Format:
    """``make`` writes a valid set into a folder, ``read`` reads it; ``files`` of it are damaged."""

    make: Callable[[Path], None]
    read: Callable[[Path], None]
    files: tuple[str, ...]


def picture(seed: int, *shape: int, top: int = 256) -> np.ndarray:
    kind = np.uint8 if top == 256 else np.uint16
    return np.random.default_rng(seed).integers(0, top, (H, W, *shape), dtype=kind)


def read_all_views(scene: Scene) -> None:
    """Read all views, also after an error; then raise the first one."""
    first = None
    for name in scene.cameras:
        try:
            scene.read(name)
        except InputError as error:
            first = first or error
    if first is not None:
        raise first


def read_each(read: Callable[[Path], Any], files: Iterator[Path]) -> None:
    for file in sorted(files):
        read(file)


def make_photographs(folder: Path) -> None:
    pictures = {
        "a.png": Image.fromarray(picture(0, 3)),
        "b.jpg": Image.fromarray(picture(1, 3)),
        "c.png": Image.fromarray(picture(2, 4), "RGBA"),
        "d.png": Image.fromarray(picture(3, top=65536)),
        "e.png": Image.fromarray(picture(4, 3)).quantize(16),
        "f.webp": Image.fromarray(picture(5, 3)),
        "g.tif": Image.fromarray(picture(6, 3)),
        "h.bmp": Image.fromarray(picture(7, 3)),
        "i.ppm": Image.fromarray(picture(8, 3)),
        "j.png": Image.fromarray(picture(9)),
    }
    frames = []
    for number, (name, image) in enumerate(pictures.items()):
        image.save(folder / name)
        pose = np.eye(4)
        pose[0, 3] = number
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    Image.fromarray(picture(10, top=65536)).save(folder / "a_depth.png")
    np.save(folder / "b_depth.npy", picture(11).astype(np.float32))
    frames[0] |= {"depth_file_path": "a_depth.png", "k1": 0.05, "p1": 0.001}
    frames[1] |= {"depth_file_path": "b_depth.npy", "depth_unit_scale_factor": 0.01}
    frames[2] |= {"camera_model": "OPENCV_FISHEYE", "k1": 0.01}
    estimated = {"focal": [0.9, 1.1], "source": "EXIF", "confidence": 0.5, "up": [0, -1, 0]}
    frames[3] |= {nerfstudio.EXTENSION_KEY: {"estimated": estimated, "near": 0.5, "far": 9.0}}
    meta = {"w": W, "h": H, "fl_x": 20.0, "fl_y": 21.0, "cx": 12.0, "cy": 8.0, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(meta))


def read_nerfstudio(folder: Path) -> None:
    scene = nerfstudio.read(folder)
    for name in scene.cameras:
        scene.sources(name)
    read_all_views(scene)


def make_alone(folder: Path) -> None:
    tags = ExifTags.Base
    exif = Image.Exif()
    exif.update({tags.Make: "Apple", tags.Model: "iPhone", tags.Orientation: 6})
    head = b"Apple iOS\0\0\1MM\0\1" + struct.pack(">HHII", 8, 10, 3, 32) + bytes(4)
    files = {
        tags.MakerNote: head + struct.pack(">6i", 0, 1, -1, 1, 0, 1),
        tags.LensModel: "back camera",
        tags.FocalLength: 4.0,
        tags.FocalLengthIn35mmFilm: 26,
        tags.FocalPlaneXResolution: 100.0,
        tags.FocalPlaneYResolution: 100.0,
        tags.ExifImageWidth: W,
        tags.ExifImageHeight: H,
    }
    exif.get_ifd(ExifTags.IFD.Exif).update(files)
    for number, name in enumerate(("a.jpg", "b.png", "c.tif", "d.webp")):
        Image.fromarray(picture(number, 3)).save(folder / name, exif=exif)


def make_ids(folder: Path) -> None:
    Image.fromarray(picture(0) // 8).save(folder / "grey.png")
    Image.fromarray(picture(0, 3) // 64).save(folder / "colours.png")
    Image.fromarray(picture(0, 3)).quantize(8).save(folder / "palette.png")
    Image.fromarray(picture(0, top=65536)).save(folder / "deep.png")
    Image.fromarray(picture(0) > 128).save(folder / "bits.png")
    np.save(folder / "numbers.npy", picture(0).astype(np.int32))


def make_masks(folder: Path) -> None:
    (folder / "00").mkdir()
    for name in ("cup", "table top"):
        Image.fromarray((picture(len(name)) > 128).astype(np.uint8) * 255).save(
            folder / "00" / f"{name}.png"
        )
    (folder / "classes.txt").write_text("cup\ntable top\n")


def make_llff(folder: Path) -> None:
    rows = []
    for number in range(2):
        Image.fromarray(picture(number, 3)).save(new_folder(folder / "images") / f"{number}.png")
        pose = np.column_stack([[0, 1, 0], [1, 0, 0], [0, 0, -1], [number, 0, 0], [H, W, 20.0]])
        rows.append([*pose.ravel(), 1.0, 9.0])
    np.save(folder / "poses_bounds.npy", np.array(rows, np.float64))


def new_folder(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def make_sparse_cameras() -> list[tuple[int, int, str, tuple[float, ...]]]:
    return [
        (1, 1, "PINHOLE", (20.0, 21.0, 12.0, 8.0)),
        (2, 4, "OPENCV", (20.0, 21.0, 12.0, 8.0, 0.05, 0.0, 0.001, 0.0)),
    ]


def make_sparse_text(folder: Path) -> None:
    sparse = new_folder(folder / "sparse")
    cameras = make_sparse_cameras()
    lines = [f"{n} {name} {W} {H} {' '.join(map(str, values))}" for n, _, name, values in cameras]
    (sparse / "cameras.txt").write_text("# cameras\n" + "\n".join(lines) + "\n")
    lines, points = [], "1.0 2.0 1 3.0 4.0 -1"
    for number in range(1, 4):
        Image.fromarray(picture(number, 3)).save(new_folder(folder / "images") / f"{number}.png")
        lens = cameras[number % len(cameras)][0]
        lines.append(f"{number} 1 0 0 0 {number} 0.5 0 {lens} {number}.png\n{points}")
    (sparse / "images.txt").write_text("# images\n" + "\n".join(lines) + "\n")


def make_sparse_binary(folder: Path) -> None:
    make_sparse_text(folder)
    shutil.rmtree(folder / "sparse")
    sparse, cameras = new_folder(folder / "sparse"), make_sparse_cameras()
    data = struct.pack("<Q", len(cameras))
    for number, model, _, parameters in cameras:
        data += struct.pack(f"<iiQQ{len(parameters)}d", number, model, W, H, *parameters)
    (sparse / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", 3)
    for number in range(1, 4):
        lens = cameras[number % len(cameras)][0]
        data += struct.pack("<i7di", number, 1, 0, 0, 0, number, 0.5, 0, lens)
        data += f"{number}.png".encode() + b"\0" + struct.pack("<Qddq", 1, 1.0, 2.0, 1)
    (sparse / "images.bin").write_bytes(data)


def camera(x: float) -> Camera:
    return pinhole.camera(W, H, 20.0, 12, 8, place=(x, 0, 0))


def make_clip(key: str) -> re10k.Clip:
    cameras = {str(i): camera(i) for i in range(3)}
    pictures = {name: View(name, cam, picture(int(name), 3)) for name, cam in cameras.items()}
    return re10k.encode_clip(Scene(key, cameras, pictures.__getitem__))


def make_chunks(folder: Path) -> None:
    re10k.write(folder, [make_clip("0a"), make_clip("0b")], chunk_bytes=1)


def read_chunks(folder: Path) -> None:
    first = None
    for key, name in re10k.read_index(folder).items():
        for clip in re10k.read_chunk(folder / name):
            try:
                read_all_views(clip.scene())
                read_each(glance, clip.images)
            except InputError as error:
                first = first or InputError(f"{folder / name}: {error}")
        read_all_views(re10k.read(folder, key))
    if first is not None:
        raise first


def make_labels(folder: Path) -> None:
    square = [[2.0, 2], [20, 2], [20, 12], [2, 12]]
    objects = [
        {"category": "cup", "segmentation": square, "bbox": [2, 2, 20, 12]},
        {"category": "cup", "segmentation": square, "bbox": [2, 2, 20, 12], "holes": [square]},
        {"category": "table", "segmentation": square, "bbox": [2, 2, 20, 12]},
    ]
    for name in ("a", "b"):
        record = {"info": {"name": f"{name}.jpg", "width": W, "height": H}, "objects": objects}
        (folder / f"{name}.json").write_text(json.dumps(record))


def read_all_labels(folder: Path) -> None:
    for frame in labelled_frames(folder):
        read_labels(folder, frame, 30, 20)


def make_indices(folder: Path) -> None:
    pair = ScenePair(
        options={"scene": "x"},
        labels="label/room",
        context=("a", "b"),
        target=("c",),
        categories=("cup",),
        measured={"o": 0.5},
    )
    index = Index(
        format="lerf_ovs", rule={"name": "around"}, scenes={"room": pair}, left_out={"d": "why"}
    )
    write_index(folder / "pairs.json", index)
    published = {"5a": {"context": [0, 40], "target": [10, 20]}, "5b": None}
    (folder / "published.json").write_text(json.dumps(published))
    old = {"room": {"context": ["a", "b"], "target": ["c"], "categories": ["cup"]}}
    (folder / "old.json").write_text(json.dumps(old))


def gaussians(n: int = 40) -> Gaussians:
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(n, 4))
    arrays = {
        "means": rng.normal(size=(n, 3)),
        "scales": rng.uniform(0.1, 1, (n, 3)),
        "quats": quats / np.linalg.norm(quats, axis=1, keepdims=True),
        "opacities": rng.random(n),
        "sh": rng.normal(size=(n, 4, 3)),
        "features": rng.random((n, 4)),
    }
    arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
    return Gaussians.from_arrays({**arrays, "source": np.arange(n, dtype=np.int32)})


def make_field(folder: Path) -> None:
    encoder = load_encoder("lexicon")
    words = encoder.encode_text(["cup", "table"])
    features = np.repeat(words[:, None], 2, 1).astype(np.float32)
    codes = np.array([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7]], np.float32)
    bank = MemoryBank(np.array([3, 7], np.int32), codes, features, np.ones((2, 2), bool))
    cameras = {"a": camera(0), "b": camera(1)}
    field = SemanticField(gaussians(), bank, cameras, {"encoder": "lexicon", "codes": "grid"})
    field.teach("fox", 3).rename(7, "Anna's").without([7]).save(folder / "field")


def make_arrays(folder: Path) -> None:
    labels = picture(0).astype(np.int32)[None]
    arrays = {"labels": labels, "margin": np.ones(labels.shape, np.float32)}
    for compress in (False, True):
        spec = replace(load_spec("labels"), compress=compress)
        (folder / f"labels{compress}.npz").write_bytes(encode_arrays(arrays, spec))


def read_arrays(folder: Path) -> None:
    spec = load_spec("labels")
    for file in sorted(folder.iterdir()):
        decode_arrays(file.read_bytes(), spec, str(file))


def make_tables(folder: Path) -> None:
    rows = [
        {"scene": f"s{i % 3}", "stage": "views", "kind": "InputError", "reason": f"why {i}" * 3}
        for i in range(40)
    ]
    spec = load_spec("failures")
    rows = [{name: row.get(name, "x") for name in spec.columns} for row in rows]
    table = pa.Table.from_pylist(rows, schema=spec.schema)
    (folder / "failures.parquet").write_bytes(encode_table(table, spec))
    spec = load_spec("objects")
    numbers = [{name: column.low or 0 for name, column in spec.columns.items()}] * 40
    table = pa.Table.from_pylist(numbers, schema=spec.schema)
    (folder / "objects.parquet").write_bytes(encode_table(table, spec))


def read_tables(folder: Path) -> None:
    for file in sorted(folder.iterdir()):
        spec = load_spec(file.stem)
        decode_table(file.read_bytes(), spec, str(file)).to_pylist()


def make_ply(folder: Path) -> None:
    save_ply(gaussians(), folder / "a.ply", np.arange(40) % 3, full=True)
    content = plyfile.PlyData.read(folder / "a.ply")
    plyfile.PlyData([content["vertex"]], text=True).write(folder / "b.ply")
    faces = np.array([([0, 1, 2],), ([3, 4],)], [("vertex_indices", "O")])
    faces = plyfile.PlyElement.describe(faces, "face", len_types={"vertex_indices": "u4"})
    plyfile.PlyData([faces, content["vertex"]], byte_order=">").write(folder / "c.ply")


def make_spz(folder: Path) -> None:
    save_spz(gaussians(), folder / "a.spz")
    # Its content, in which damage is not found by the checksum of gzip alone.
    (folder / "b.spz").write_bytes(gzip.decompress((folder / "a.spz").read_bytes()))


def make_checkpoints(folder: Path) -> None:
    state = {"encoder.a.weight": torch.arange(12.0).reshape(3, 4), "encoder.b": torch.ones(5)}
    torch.save({"state_dict": state, "epoch": 3}, folder / "new.ckpt")
    torch.save(state, folder / "old.ckpt", _use_new_zipfile_serialization=False)


def read_checkpoints(folder: Path) -> None:
    for file in sorted(folder.iterdir()):
        for tensor in read_state(file).values():
            tensor.to(torch.float32, copy=True)


SMALL = Architecture(widths=(4, 6), hidden=8)
RUN = {"architecture": {"widths": [4, 6], "hidden": 8}, "steps": 3}


def train_branch() -> tuple[Branch, torch.optim.Optimizer]:
    branch = make_branch(SMALL, 0)
    optimiser = torch.optim.AdamW(branch.parameters(), foreach=False)
    for parameter in branch.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimiser.step()
    return branch, optimiser


def make_weights(folder: Path) -> None:
    branch, optimiser = train_branch()
    (folder / "branch.safetensors").write_bytes(save_branch(branch))
    schema = load_spec("metrics").schema
    values = {"string": "x", "bool": True}
    row = {field.name: values.get(str(field.type), 1) for field in schema}
    save_checkpoint(folder, branch, optimiser, RUN, [row])


def read_weights(folder: Path) -> None:
    load_branch(folder / "branch.safetensors")
    load_checkpoint(folder, *train_branch(), RUN)


def make_versions(folder: Path) -> None:
    Versions(folder).add(b"weights", {"scores": {"iou": 0.5}}, True, "first")


def read_versions(folder: Path) -> None:
    versions = Versions(folder)
    versions.all()
    current = versions.current()
    if current is not None:
        versions.weights(current)


FORMATS = {
    "transforms.json": Format(make_photographs, read_nerfstudio, ("*.json",)),
    "photographs, depth": Format(make_photographs, read_nerfstudio, ("[a-j]*.*",)),
    "photographs alone": Format(
        make_alone,
        lambda f: read_each(lambda file: unposed.photograph(file, "a"), f.iterdir()),
        ("*",),
    ),
    "id maps": Format(make_ids, lambda f: read_each(read_ids, f.iterdir()), ("*",)),
    "class masks": Format(make_masks, lambda f: read_labels(f, "00", W, H), ("*.txt", "*/*.png")),
    "LLFF": Format(make_llff, lambda f: read_all_views(llff.read(f)), ("*.npy",)),
    "COLMAP binary": Format(
        make_sparse_binary, lambda f: read_all_views(colmap.read(f)), ("sparse/*",)
    ),
    "COLMAP text": Format(
        make_sparse_text, lambda f: read_all_views(colmap.read(f)), ("sparse/*",)
    ),
    "chunks": Format(make_chunks, read_chunks, ("*.torch", "*.torch", "*.json")),
    "label JSON": Format(make_labels, read_all_labels, ("*.json",)),
    "pair index": Format(make_indices, lambda f: read_each(read_index, f.iterdir()), ("*.json",)),
    "field": Format(
        make_field, lambda f: SemanticField.load(f / "field"), ("field/*.json", "field/*.npz")
    ),
    "npz": Format(make_arrays, read_arrays, ("*.npz",)),
    "Parquet": Format(make_tables, read_tables, ("*.parquet",)),
    "ply": Format(make_ply, lambda f: read_each(load_ply, f.iterdir()), ("*.ply",)),
    "spz": Format(make_spz, lambda f: read_each(load_spz, f.iterdir()), ("*.spz",)),
    "checkpoints": Format(make_checkpoints, read_checkpoints, ("*.ckpt",)),
    "weights": Format(make_weights, read_weights, ("*.safetensors", "*.pt")),
    "versions": Format(make_versions, read_versions, ("*.json", "versions/*")),
}


def trial(name: str, number: int, seed: int, folder: Path) -> None:
    """Damage one file of the set in ``folder``, read the set, and restore the file."""
    kind = FORMATS[name]
    rng = random.Random(f"{seed} {name} {number}")
    files = sorted(folder.glob(rng.choice(kind.files)))
    file = rng.choice([path for path in files if path.is_file()])
    content = file.read_bytes()
    file.write_bytes(damage(content, file.name, rng))
    try:
        kind.read(folder)
    finally:
        file.write_bytes(content)


def verdict(name: str, number: int, seed: int, folder: Path) -> tuple[str, str]:
    """Read a damaged file; return the kind of outcome and the message."""
    try:
        trial(name, number, seed, folder)
    except SLGaussianError as error:
        wrong = _wrong(str(error), folder)
        return ("other", f"{wrong}: {str(error)!r:.300}") if wrong else ("refused", str(error))
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)
        ours = [f"{Path(f.filename).name}:{f.lineno}" for f in place if "slgaussian" in f.filename]
        return "other", f"{type(error).__name__} in {' '.join(ours[-3:])}: {str(error)[:200]}"
    return "accepted", ""


def _wrong(said: str, folder: Path) -> str | None:
    """Return the fault of a message for the user, or None."""
    try:
        said.encode()
    except UnicodeEncodeError:
        return "cannot be printed"
    if "\n" in said:
        return "is more than a line"
    if len(said) > 1000:
        return "is too long"
    elsewhere = said.startswith(("/: ", "/etc/passwd: "))  # of TEXTS
    return None if elsewhere or str(folder) in said else "names no file"
