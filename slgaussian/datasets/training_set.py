"""PyTorch dataset of a training set written by ``slgaussian dataset``.

The set is a folder, or a fsspec URL, with ``index.parquet`` (spec ``training_set``) and the shards
listed there: tar files in the WebDataset format (:mod:`slgaussian.datasets.shards`).

>>> from torch.utils.data import DataLoader
>>> from slgaussian.datasets import TrainingSet
>>> samples = TrainingSet("set/", split="train")
>>> loader = DataLoader(samples, batch_size=4, shuffle=True, num_workers=2)

Samples have different numbers of objects, which are padded with zeros in a batch: id 0 is no
object, present in no view.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow.compute as pc
import torch
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data import Dataset
from torch.utils.data._utils.collate import default_collate_fn_map

from slgaussian.datasets.photographs import rgb
from slgaussian.datasets.shards import INDEX, REPAIR, unpack
from slgaussian.datasets.splits import SPLITS
from slgaussian.errors import InputError, SpecError
from slgaussian.formats import strict_json
from slgaussian.formats.images import open_image
from slgaussian.storage.encoding import decode_arrays, decode_table
from slgaussian.storage.remote import explain_error, file_system_errors, open_file_system
from slgaussian.storage.specs import load_spec

SPECS = {"geometry": "example_geometry", "labels": "labels", "bank": "bank"}
"""The spec of each ``.npz`` member of a sample."""


class TrainingSet(Dataset[dict[str, Any]]):
    """Samples of a training set, each read on access.

    An item is a dict. V is the number C of context views or T of targets, N that of objects:

    - ``sample``, ``clip``, ``place``: text
    - ``origin``: float64 [3], position in the world of the origin of the poses, zero unless float32
      cannot hold them there
    - ``context`` and ``target``: dicts of ``image`` uint8 [V, 3, H, W]; ``K`` float32 [V, 3, 3] in
      pixels, ``c2w`` float32 [V, 4, 4] with OpenCV axes; ``near_far`` float32 [V, 2], 0 where
      unknown; ``depth`` float32 [V, H, W] along z, 0 where unknown; ``labels`` int64 [V, H, W], 0
      for no object; ``margin`` float32 [V, H, W], the vote margin of the label; ``opaque`` bool
      [V, H, W], false where the photograph is transparent and so shows nothing; and for the context
      ``confirmed`` bool [V, H, W], where another view has the same depth
    - ``objects``: ``ids`` int64 [N], ``codes`` float32 [N, D], ``features`` float32 [N, C, F] and
      ``present`` bool [N, C]
    - ``quality``: numbers by column name of the index

    Args:
        folder: path or fsspec URL
        split: {"train", "test"}, optional. Default: all samples.
        where: Filter on the rows of the index, such as ``pc.field("overlap") > 0.7``.

    Attributes:
        rows: pyarrow.Table. Rows of the index, in the order of the items.

    Raises:
        InputError: If there is no such split, or no row remains.
        pyarrow.ArrowInvalid: If the filter names no column.
        SpecError: If the index cannot be read or violates its spec.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        split: str | None = None,
        where: pc.Expression | None = None,
    ) -> None:
        self.folder = os.fspath(folder).rstrip("/")
        if split is not None and split not in SPLITS:
            raise InputError(f"split: found {split!r}, expected one of {', '.join(SPLITS)}")
        rows = decode_table(
            self._read(INDEX), load_spec("training_set"), f"{self.folder}/{INDEX}", REPAIR
        )
        if split is not None:
            rows = rows.filter(pc.field("split") == split)
        if where is not None:
            rows = rows.filter(where)
        if not rows.num_rows:
            which = "" if split is None else f" of the split {split!r}"
            raise InputError(f"{self.folder}: has no sample{which} that was asked for")
        self.rows = rows

    def __repr__(self) -> str:
        return f"TrainingSet({self.folder!r}, {len(self)} samples)"

    def __len__(self) -> int:
        return self.rows.num_rows

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Read one sample; SpecError, which names the shard, if it is damaged or missing."""
        members = self.members(index)
        row: dict[str, Any] = self.rows.slice(index, 1).to_pylist()[0]
        label = f"{self.folder}/{row['shard']}: {row['sample']}"
        try:
            geometry, labels, bank = (
                decode_arrays(
                    members[f"{name}.npz"], load_spec(spec), f"{label}.{name}.npz", REPAIR
                )
                for name, spec in SPECS.items()
            )
            info = strict_json.parse(members["about.json"])
            images = {role: _images(members, role) for role in ("context", "target")}
            count, expected = sum(map(len, images.values())), len(geometry["K"])
            if count != expected or not isinstance(info, dict):
                raise ValueError(f"{count} images of {expected}, or about.json is no object")
        except KeyError as missing:
            raise SpecError(f"{label}: has no {missing}; {REPAIR}") from None
        except ValueError as error:
            raise SpecError(f"{label}: is damaged ({error}); {REPAIR}") from None
        numbers = ("K", "c2w", "near_far", "depth")
        views = {name: torch.from_numpy(geometry[name].astype(np.float32)) for name in numbers}
        views["labels"] = torch.from_numpy(labels["labels"].astype(np.int64))
        views["margin"] = torch.from_numpy(labels["margin"])
        opaque = geometry.get("opaque", np.ones(labels["labels"].shape, bool))
        views["opaque"] = torch.from_numpy(opaque)
        item: dict[str, Any] = {name: row[name] for name in ("sample", "clip", "place")}
        contexts = len(images["context"])
        for role, part in (("context", slice(contexts)), ("target", slice(contexts, None))):
            item[role] = {"image": images[role], **{name: of[part] for name, of in views.items()}}
        item["origin"] = torch.from_numpy(geometry.get("origin", np.zeros(3)))
        item["context"]["confirmed"] = torch.from_numpy(geometry["confirmed"])
        item["objects"] = _Ragged(
            ids=torch.from_numpy(bank["ids"].astype(np.int64)),
            codes=torch.from_numpy(bank["codes"]),
            features=torch.from_numpy(bank["features"].astype(np.float32)),
            present=torch.from_numpy(bank["present"]),
        )
        item["quality"] = {k: v for k, v in info.items() if isinstance(v, int | float)}
        return item

    def data(self, index: int) -> bytes:
        """Read the bytes of a sample: its members as a part of a tar file."""
        row = self.rows.slice(index, 1).to_pylist()[0]
        data = self._read(row["shard"], row["offset"], row["offset"] + row["bytes"])
        if len(data) != row["bytes"]:
            reason = f"it has {len(data)} of the {row['bytes']} bytes from {row['offset']} on"
            raise SpecError(f"{self.folder}/{row['shard']}: is damaged ({reason}); {REPAIR}")
        return data

    def members(self, index: int) -> dict[str, bytes]:
        """Read the stored members of a sample, by the suffix of their names."""
        try:
            return unpack(self.data(index))
        except ValueError as error:
            shard = self.rows["shard"][index]
            raise SpecError(f"{self.folder}/{shard}: is damaged ({error}); {REPAIR}") from None

    def _read(self, name: str, start: int | None = None, end: int | None = None) -> bytes:
        try:
            # Open it in the calling process: some file systems cannot be shared.
            fs, path = open_file_system(self.folder, "training set")
            return fs.cat_file(f"{path}/{name}", start=start, end=end)
        except file_system_errors() as error:
            raise SpecError(
                f"{self.folder}/{name}: cannot be read ({explain_error(error)}); {REPAIR}"
            ) from None


def _images(members: Mapping[str, bytes], role: str) -> torch.Tensor:
    """Decode the images of a role in the order of their numbers, uint8 [V, 3, H, W]."""
    pixels: list[np.ndarray] = []
    while suffix := next(
        (s for s in (".jpg", ".png") if f"{role}_{len(pixels)}{s}" in members), ""
    ):
        name = f"{role}_{len(pixels)}"
        with open_image(io.BytesIO(members[name + suffix])) as image:
            pixels.append(rgb(image, name))
    return torch.from_numpy(np.stack(pixels).transpose(0, 3, 1, 2).copy())


class _Ragged(dict[str, torch.Tensor]):
    """Tensors by name whose first dimension differs between samples."""


def _filled_up(values: Sequence[_Ragged], **_: Any) -> dict[str, torch.Tensor]:
    """Stack tensors of the same name, padded with zeros."""
    return {
        name: pad_sequence([value[name] for value in values], batch_first=True)
        for name in values[0]
    }


default_collate_fn_map[_Ragged] = _filled_up
