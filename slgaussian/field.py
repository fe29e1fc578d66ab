"""The semantic field: the thing a user holds. Render it, ask it, save it, load it."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from data_specs import load_spec
from slgaussian import harmonics
from slgaussian.errors import InputError, SpecError
from slgaussian.gaussians import Gaussians
from slgaussian.language import Encoder, load_encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.language.codes import nearest_code
from slgaussian.language.query import QueryResult, find, segment
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE, object_ids
from slgaussian.store import decode, encode_arrays, encode_table


@dataclass(frozen=True, eq=False)
class FieldView:
    """A semantic field as one camera sees it.

    Attributes
    ----------
    rgb : uint8 [H, W, 3]
        Mean colour of what is there; it fades to black where ``alpha`` is below :data:`VISIBLE`.
    ids : int32 [H, W]
        Object ids, 0 where there is none.
    alpha : float32 [H, W]
        Accumulated opacity in [0, 1].
    depth : float32 [H, W]
        z-depth in scene units, 0 where nothing is.
    """

    rgb: np.ndarray
    ids: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    bank: MemoryBank
    encoder: Encoder

    def query(
        self, text: str, *, threshold: float | None = None, temperature: float = 10.0
    ) -> QueryResult:
        """Where ``text`` is in this view; see :func:`slgaussian.language.query.find`."""
        return find(
            text, self.ids, self.bank, self.encoder, temperature=temperature, threshold=threshold
        )

    def segment(self, texts: Sequence[str]) -> np.ndarray:
        """Which text fits each pixel best: int32 [H, W], 0 = no object, k + 1 = ``texts[k]``."""
        return segment(texts, self.ids, self.bank, self.encoder)


@dataclass(frozen=True, eq=False)
class SemanticField:
    """Gaussians that carry ID codes, and the memory bank that says what the codes mean.

    Attributes
    ----------
    gaussians : Gaussians
        With ``features`` [N, 4]; see :class:`slgaussian.semantic.Lifting`.
    bank : MemoryBank
    cameras : mapping str -> Camera
        The context cameras by view name.
    settings : mapping
        Names and settings of every part that made the field, written into each artifact.
    """

    gaussians: Gaussians
    bank: MemoryBank
    cameras: Mapping[str, Camera]
    settings: Mapping[str, Any]

    @cached_property
    def encoder(self) -> Encoder:
        """The text encoder that belongs to the bank."""
        return load_encoder(self.settings["encoder"])

    def render(self, camera: Camera, backend: str = "auto") -> FieldView:
        """See the field through ``camera``: colour, ids and depth in one pass."""
        rgb = harmonics.colors(self.gaussians, camera)
        values = torch.cat([rgb, self.gaussians.features], 1)
        image = rasterize(self.gaussians, values, camera, backend=backend)
        drawn = image.values.float().numpy()
        ids = object_ids(drawn[..., 3:], self.bank)
        alpha, depth = image.alpha.float().numpy(), image.depth.float().numpy()
        colour = drawn[..., :3] / np.maximum(alpha, VISIBLE)[..., None]
        rgb = np.rint(colour.clip(0, 1) * 255).astype(np.uint8)
        return FieldView(rgb, ids, alpha, depth, self.bank, self.encoder)

    def labels(self) -> np.ndarray:
        """The object that each Gaussian carries most of all: int32 [N], 0 where it carries none."""
        features = self.gaussians.features.numpy()
        labelled = features[:, 3] >= VISIBLE
        ids = np.zeros(len(features), np.int32)
        if labelled.any():
            rows = nearest_code(features[labelled, :3] / features[labelled, 3:], self.bank.codes)
            ids[labelled] = self.bank.ids[rows]
        return ids

    def objects(self) -> pa.Table:
        """One row an object: its id, its code and how many Gaussians carry it most of all."""
        labels = self.labels()
        rows = np.searchsorted(self.bank.ids, labels[labels > 0])  # ids are positive and ascending
        counts = np.bincount(rows, minlength=len(self.bank.ids))
        columns = {"id": self.bank.ids.astype(np.int64)}
        for channel, letter in enumerate("rgb"):
            columns[f"code_{letter}"] = self.bank.codes[:, channel].astype(np.float64)
        columns["gaussians"] = counts.astype(np.int64)
        return pa.table(columns, schema=load_spec("objects").schema)

    def save(self, path: str | Path) -> None:
        """Write the field to folder ``path``: complete, or not at all.

        A field that is there already is replaced.

        Raises
        ------
        InputError
            If the folder cannot be written, or holds something that is not a field.
        """
        path = Path(path)
        check_target(path)
        draft = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
        try:
            draft.chmod(0o755)
            for name, arrays in self._arrays().items():
                rules = load_spec(name)
                rules.check_arrays(arrays, f"{name}.npz")
                (draft / f"{name}.npz").write_bytes(encode_arrays(arrays, rules.compress))
            (draft / "objects.parquet").write_bytes(encode_table(self.objects()))
            (draft / "field.json").write_text(json.dumps(self._about(), indent=1) + "\n")
            if path.exists():
                os.rename(path, old := Path(f"{draft}-old"))
                os.rename(draft, path)
                shutil.rmtree(old)
            else:
                os.rename(draft, path)
        except BaseException as error:
            shutil.rmtree(draft, ignore_errors=True)
            if isinstance(error, OSError):
                raise _unwritable(path, error) from error
            raise

    @staticmethod
    def load(path: str | Path) -> SemanticField:
        """Read a field folder.

        Raises
        ------
        SpecError
            If a file of it is missing or damaged, or the encoder is no longer that of the bank;
            the message names the file.
        """
        path = Path(path)
        about_file = path / "field.json"
        if not about_file.is_file():
            raise SpecError(
                f"{path}: no field.json there, expected a folder that `slgaussian field` or "
                "SemanticField.save wrote"
            )
        try:
            about = json.loads(about_file.read_text())
            cameras = {
                name: Camera(np.array(c.pop("K")), np.array(c.pop("c2w")), **c)
                for name, c in about["cameras"].items()
            }
            settings = dict(about["settings"])
            encoder = load_encoder(settings["encoder"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SpecError(f"{about_file}: damaged ({error}); build the field again") from error
        gaussians = Gaussians.from_arrays(_read(path / "gaussians.npz"))
        if gaussians.features is None or gaussians.features.shape[1] != 4:
            raise SpecError(f"{path / 'gaussians.npz'}: no features [N, 4]; build the field again")
        bank = MemoryBank.from_arrays(_read(path / "bank.npz"))
        if bank.features.shape[2] != encoder.encode_text(encoder.canonical).shape[1]:
            raise SpecError(
                f"{path / 'bank.npz'}: made by another version of the encoder {encoder.name!r}; "
                "build the field again"
            )
        return SemanticField(gaussians, bank, cameras, settings)

    def _arrays(self) -> dict[str, dict[str, np.ndarray]]:
        return {"gaussians": self.gaussians.to_arrays(), "bank": self.bank.to_arrays()}

    def _about(self) -> dict[str, Any]:
        cameras = {
            name: {
                "K": camera.K.tolist(),
                "c2w": camera.c2w.tolist(),
                "width": camera.width,
                "height": camera.height,
                "near": camera.near,
                "far": camera.far,
            }
            for name, camera in self.cameras.items()
        }
        return {"settings": dict(self.settings), "cameras": cameras}


def check_target(path: Path) -> None:
    """Make the parents of ``path`` and see that a field may be written there.

    Call it before the work, so that hours are not lost to a folder that cannot be written.

    Raises
    ------
    InputError
        If a parent cannot be made or written, or ``path`` holds something that is not a field.
    """
    if path.exists() and not (path / "field.json").is_file() and not _is_empty_folder(path):
        raise InputError(f"{path}: exists and is not a field; choose another folder, or remove it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        os.rmdir(tempfile.mkdtemp(prefix=".probe-", dir=path.parent))
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(
        f"{path}: cannot be written ({error.strerror}); choose a folder that you may write to, on "
        "a disk with room"
    )


def _read(file: Path) -> dict[str, np.ndarray]:
    rules = load_spec(file.stem)
    try:
        data = file.read_bytes()
    except OSError as error:
        raise SpecError(f"{file}: {error.strerror}; build the field again") from error
    arrays = decode(data, rules, str(file), repair="build the field again")
    rules.check_arrays(arrays, str(file))
    return arrays


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())
