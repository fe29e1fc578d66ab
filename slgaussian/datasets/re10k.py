"""RealEstate10K in the format of pixelSplat and MVSplat: chunks and an index.

A chunk is a ``.torch`` file of about 100 MB: a list of clips, each a dict of ``key``, ``url``,
``timestamps`` int64 [N] in microseconds, ``cameras`` float32 [N, 18] and ``images``, N uint8
tensors of encoded JPEG bytes. ``index.json`` of a split maps keys to chunks. A row of ``cameras``
is fx, fy, cx, cy, 0, 0 and the world-to-camera matrix [3, 4] by rows, OpenCV axes; the intrinsics
are fractions of width and height. Where photographs are transparent, an entry has ``masks`` too,
which other readers ignore: for each image the bytes of a PNG, white where it is opaque, or none.

Chunks are read with PyTorch's restricted unpickler, so an untrusted chunk cannot run code.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
from PIL import Image

from slgaussian.checks import check_intrinsics
from slgaussian.datasets.photographs import MIN_OPAQUE_ALPHA, rgb
from slgaussian.errors import InputError
from slgaussian.formats import strict_json, tensorfile
from slgaussian.formats.images import open_image
from slgaussian.io import write_atomic
from slgaussian.scene import Camera, Scene, View, local_origin
from slgaussian.storage.remote import explain_error, file_system_errors, open_file_system

INDEX = "index.json"
CHUNK_BYTES = 100_000_000
"""A new chunk is begun when the images of the current one reach this size, as in the original."""
JPEG_QUALITY = 95
ROW_LENGTH = 18
FRAME_TIME = 33_333  # interval between the frames of a scene without timestamps, microseconds


@dataclass(frozen=True, eq=False)
class Clip:
    """One clip as stored, without decoding; only types and counts are checked.

    Attributes:
        timestamps: int64 [N]. Microseconds.
        cameras: float32 [N, 18]. Rows as described in the module's docstring.
        images: tuple of N bytes. Encoded JPEGs.
        origin: float64 [3]. Point of the world to which ``cameras`` are relative, zero unless
            float32 cannot hold them in the world (:func:`slgaussian.scene.local_origin`). It is an
            additional key of the entry, which other programs ignore.
        masks: tuple of N bytes. Encoded PNGs of the opaque pixels, empty where all are; or empty.
    """

    key: str
    url: str
    timestamps: np.ndarray
    cameras: np.ndarray
    images: tuple[bytes, ...]
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    masks: tuple[bytes, ...] = ()

    def camera(self, number: int, size: tuple[int, int], label: str) -> Camera:
        """Return the camera of a frame of a size (width, height), in the world."""
        return camera_from_row(self.cameras[number], *size, label).relative_to(-self.origin)

    def view(self, number: int, prefix: str = "") -> View:
        """Decode one frame; InputError, which begins with ``prefix``, if it is damaged."""
        label = f"{prefix}clip {self.key!r}, frame {number}"
        try:
            with open_image(io.BytesIO(self.images[number])) as image:
                pixels = rgb(image, label)
        except ValueError as error:
            raise InputError(f"{label}: its JPEG cannot be decoded ({error})") from None
        camera = self.camera(number, pixels.shape[1::-1], label)
        return View(str(number), camera, pixels, opaque=self.opaque(number))

    def opaque(self, number: int) -> np.ndarray | None:
        """Decode the opaque pixels of a frame, bool [H, W]; None if all are.

        InputError if they are damaged.
        """
        if not self.masks or not self.masks[number]:
            return None
        try:
            with open_image(io.BytesIO(self.masks[number]), ["PNG"]) as image:
                return np.asarray(image.convert("L")) >= MIN_OPAQUE_ALPHA
        except ValueError as error:
            label = f"clip {self.key!r}, frame {number}"
            raise InputError(f"{label}: its mask cannot be decoded ({error})") from None

    def scene(self, source: str = "") -> Scene:
        """Return the clip as a scene with views "0" to "N - 1", each decoded when it is read.

        ``source`` is the name of its file, for messages.

        Raises:
            InputError: If no image can be decoded, or a camera is invalid. A single damaged image
                is an error only when its view is read.
        """
        prefix = f"{source}: " if source else ""
        label = f"{prefix}clip {self.key!r}"
        sizes = [_size(data) for data in self.images]
        usual = next(filter(None, sizes), None)
        if usual is None:
            raise InputError(f"{label}: none of its {len(sizes)} images can be decoded")
        cameras = {
            str(number): self.camera(number, size or usual, f"{label}, frame {number}")
            for number, size in enumerate(sizes)
        }

        def read_frame(name: str) -> View:
            if name not in cameras:
                raise InputError(f"{label}: has no frame {name!r}")
            return self.view(int(name), prefix)

        return Scene(self.key, cameras, read_frame)


def read(path: str | Path, key: str) -> Scene:
    """Read one clip of a split as a scene; see :meth:`Clip.scene`.

    Args:
        path: path or fsspec URL. The folder of a split, with ``index.json`` and its chunks.

    Raises:
        InputError: If the index or the chunk cannot be read, or the clip is missing or invalid.
    """
    name = files(path, key)[0].name
    for clip in read_chunk(chunk := f"{path}/{name}"):
        if clip.key == key:
            return clip.scene(chunk)
    raise InputError(f"{chunk}: has no clip {key!r}, though {INDEX} says so")


def files(path: str | Path, key: str) -> list[Path]:
    """Return the file of a clip, its chunk; InputError if there is no such clip."""
    index = read_index(path)
    if key not in index:
        examples = ", ".join(list(index)[:3])
        raise InputError(f"{path}: no clip {key!r} among its {len(index)}, such as {examples}")
    return [Path(f"{path}/{index[key]}")]


def scenes(path: str | Path) -> dict[str, dict[str, Any]]:
    """List the clips of a split, each with the arguments of :func:`read` besides the path."""
    return {key: {"key": key} for key in read_index(path)}


def read_index(path: str | Path) -> dict[str, str]:
    """Read the chunk file of every clip of a split, by key, from its ``index.json``."""
    file = f"{path}/{INDEX}"
    try:
        with fsspec.open(file, "rb") as stream:
            index = strict_json.parse(stream.read())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as JSON ({error})") from None
    names = index.values() if isinstance(index, dict) else [None]
    if not all(isinstance(n, str) and n == os.path.basename(n)[:255] for n in names):
        raise InputError(f"{file}: expected the name of a chunk for every key")
    return index


def chunk_names(path: str | Path) -> list[str]:
    """List the names of all chunks of a split in order, also those missing in its index."""
    fs, folder = open_file_system(path, "chunks")
    try:
        entries = fs.ls(folder, detail=False)
    except file_system_errors() as error:
        raise InputError(
            f"{path}: cannot be listed ({explain_error(error)}); expected a folder of chunks"
        ) from None
    return sorted(os.path.basename(file) for file in entries if file.endswith(".torch"))


def read_chunk(file: str | Path) -> list[Clip]:
    """Read all clips of a chunk, still encoded.

    Raises:
        InputError: If the file cannot be read, is truncated, or contains something else.
    """
    try:
        with fsspec.open(os.fspath(file), "rb") as stream:
            data = stream.read()
    except Exception as error:
        if not isinstance(error, (*file_system_errors(), ValueError)):
            raise
        raise InputError(
            f"{file}: cannot be read as a chunk ({explain_error(error)}); get it again"
        ) from None
    return clips_in(data, file)


def clips_in(data: bytes, file: str | Path) -> list[Clip]:
    """Parse the clips in the bytes of a chunk, still encoded; InputError names ``file``."""
    try:
        content = tensorfile.load(data)
    except ValueError as error:
        raise InputError(
            f"{file}: cannot be read as a chunk ({error}); it is damaged or holds other things "
            "than clips, get it again"
        ) from None
    if not isinstance(content, list):
        raise InputError(f"{file}: found a {type(content).__name__}, expected a list of clips")
    # A pickle may reference one tensor many times, each of which would be copied.
    left = len(data)
    clips = []
    for number, entry in enumerate(content):
        try:
            clips.append(_clip(entry, left))
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise InputError(
                f"{file}: clip {number}: expected key, url, N images of uint8, N timestamps of "
                f"int64 and cameras float32 [N, {ROW_LENGTH}] ({error})"
            ) from None
        left -= sum(map(len, (*clips[-1].images, *clips[-1].masks)))
    return clips


def _clip(entry: Any, max_bytes: int) -> Clip:
    """Parse an entry as a clip, whose images may have ``max_bytes`` bytes in total."""
    key, url, images = entry["key"], entry["url"], entry["images"]
    times, cameras = (_array(entry[name]) for name in ("timestamps", "cameras"))
    fits = isinstance(key, str) and isinstance(url, str) and isinstance(images, list)
    fits = fits and times.shape == (len(images),) and times.dtype.kind == "i"
    fits = fits and cameras.shape == (len(images), ROW_LENGTH) and cameras.dtype.kind == "f"
    arrays, masks = ([_array(data) for data in entry.get(k, ())] for k in ("images", "masks"))
    fits = fits and len(masks) in (0, len(images))
    if not fits or any(array.dtype != np.uint8 for array in (*arrays, *masks)):
        raise ValueError("its values have other types or lengths")
    if sum(array.size for array in (*arrays, *masks)) > max_bytes:
        raise ValueError("it has more bytes of images than the file")
    origin = _array(entry["origin"]) if "origin" in entry else np.zeros(3)
    if origin.shape != (3,) or origin.dtype != np.float64 or not np.isfinite(origin).all():
        raise ValueError(f"its origin is {origin}, not 3 finite float64 numbers")
    encoded = [tuple(array.tobytes() for array in part) for part in (arrays, masks)]
    rows = cameras.astype(np.float32)
    return Clip(key, url, times.astype(np.int64), rows, encoded[0], origin, encoded[1])


def _array(tensor: Any) -> np.ndarray:
    """Return the array of a tensor that stores each of its elements; else raise."""
    import torch

    if not isinstance(tensor, torch.Tensor):
        raise TypeError(f"found a {type(tensor).__name__}, expected a tensor")
    array = tensor.numpy()  # raises for other layouts
    if array.nbytes > tensor.untyped_storage().nbytes():
        raise ValueError("a tensor repeats its elements")
    return array


def camera_from_row(row: np.ndarray, width: int, height: int, label: str = "camera") -> Camera:
    """Return the camera of a row of 18 numbers; InputError with the label if it is invalid."""
    row = np.asarray(row, np.float64)
    if row.shape != (ROW_LENGTH,) or not np.isfinite(row).all() or row[4:6].any():
        raise InputError(
            f"{label}: found {row.tolist()}, expected {ROW_LENGTH} finite numbers, the fifth and "
            "sixth 0"
        )
    fx, fy, cx, cy = row[:4] * (width, height, width, height)
    rotation, translation = row[6:].reshape(3, 4)[:, :3], row[9::4]
    c2w = np.eye(4)
    c2w[:3, :3] = rotation.T
    c2w[:3, 3] = -rotation.T @ translation
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    try:
        camera = Camera(K, c2w, width, height)
        check_intrinsics(camera, fractions=True)
    except InputError as error:
        raise InputError(f"{label}: {error}") from None
    return camera


def row_from_camera(camera: Camera) -> np.ndarray:
    """Invert :func:`camera_from_row`: float32 [18], without the skew of K."""
    fractions = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]] / ([camera.width, camera.height] * 2)
    return np.array([*fractions, 0, 0, *camera.w2c[:3].ravel()], np.float32)


def encode_clip(scene: Scene, passed_over: Callable[[InputError], None] | None = None) -> Clip:
    """Encode all views of a scene as a clip, in their order, without ground truth.

    Args:
        passed_over: Called with the error of each view that cannot be read, which is then left out.

    Raises:
        InputError: If a view cannot be read and ``passed_over`` is None, or no view can be read.
    """
    images, masks, rows = [], [], []
    origin = local_origin([camera.center for camera in scene.cameras.values()])
    for name, camera in scene.cameras.items():
        try:
            view = scene.read(name)
        except InputError as error:
            if passed_over is None:
                raise
            passed_over(error)
            continue
        buffer, mask = io.BytesIO(), io.BytesIO()
        Image.fromarray(view.image).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
        if view.opaque is not None:
            Image.fromarray(view.opaque).save(mask, "PNG")
        images.append(buffer.getvalue())
        masks.append(mask.getvalue())
        rows.append(row_from_camera(camera.relative_to(origin)))
    if not images:
        count = len(scene.cameras)
        raise InputError(f"scene {scene.name!r}: none of its {count} views can be read")
    times, masks = np.arange(len(images)) * FRAME_TIME, masks if any(masks) else []
    return Clip(scene.name, "", times, np.stack(rows), tuple(images), origin, tuple(masks))


def write(path: str | Path, clips: Iterable[Clip], chunk_bytes: int = CHUNK_BYTES) -> list[str]:
    """Add clips to the folder of a split, one chunk in memory at a time; return the new chunks.

    New chunks are numbered consecutively; ``index.json`` is written after each of them, so that a
    reader never sees an incomplete chunk.

    Raises:
        InputError: If a clip's key exists already, or the folder cannot be written.
    """
    path = Path(path)
    names: list[str] = []
    batch: list[Clip] = []
    try:
        path.mkdir(parents=True, exist_ok=True)
        index = read_index(path) if (path / INDEX).exists() else {}

        def write_chunk() -> None:
            number = max((int(Path(name).stem) for name in index.values()), default=-1) + 1
            names.append(f"{number:06d}.torch")
            write_atomic(path / names[-1], encode_chunk(batch))
            index.update({clip.key: names[-1] for clip in batch})
            write_atomic(path / INDEX, json.dumps(index, indent=1).encode())
            batch.clear()

        for clip in clips:
            if clip.key in index:
                raise InputError(
                    f"{path}: has a clip {clip.key!r} already; give the new one its own key"
                )
            batch.append(clip)
            if sum(len(image) for clip in batch for image in clip.images) >= chunk_bytes:
                write_chunk()
        if batch:
            write_chunk()
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    return names


def encode_chunk(clips: Sequence[Clip]) -> bytes:
    """Return the bytes of a chunk file of clips."""
    import torch

    buffer = io.BytesIO()

    def tensors(parts: Sequence[bytes]) -> list[torch.Tensor]:
        return [torch.from_numpy(np.frombuffer(bytearray(part), np.uint8)) for part in parts]

    entries = [
        {
            "url": clip.url,
            "timestamps": torch.from_numpy(clip.timestamps),
            "cameras": torch.from_numpy(clip.cameras),
            "images": tensors(clip.images),
            "key": clip.key,
            **({"origin": torch.from_numpy(clip.origin)} if clip.origin.any() else {}),
            **({"masks": tensors(clip.masks)} if clip.masks else {}),
        }
        for clip in clips
    ]
    torch.save(entries, buffer)
    return buffer.getvalue()


def _size(data: bytes) -> tuple[int, int] | None:
    """Return width and height of an encoded image; None if its header cannot be read."""
    try:
        with open_image(io.BytesIO(data)) as image:
            return image.size
    except ValueError:
        return None
