"""The semantic field: the thing a user holds. Render it, ask it, save it, load it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from slgaussian.errors import InputError, SpecError
from slgaussian.formats.brief import brief, said
from slgaussian.gaussians import Gaussians
from slgaussian.kernels import compiling
from slgaussian.language import Encoder
from slgaussian.language.bank import MemoryBank
from slgaussian.language.nearest import nearest_code
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.query import (
    BankReader,
    Description,
    QueryResult,
    Rules,
    ask,
    describe,
    segment,
)
from slgaussian.parts.part import Part
from slgaussian.rasterize import harmonics, rasterize
from slgaussian.scene import Camera
from slgaussian.semantic.decode import VISIBLE, Decoder, elected_ids
from slgaussian.storage import field_folder
from slgaussian.storage.field_folder import About
from slgaussian.storage.specs import load_spec
from slgaussian.storage.store import Arrays, packed


@dataclass(frozen=True, eq=False)
class FieldView:
    """A semantic field as one camera sees it.

    Attributes
    ----------
    rgb : uint8 [H, W, 3]
        Mean colour of what is there; it fades to black where ``alpha`` is below :data:`VISIBLE`.
    ids : int32 [H, W]
        Object ids, 0 where there is none.
    confidence : float32 [H, W]
        In [0, 1], about the fraction of the pixel's light by which its object leads the next one; 0
        where there is none. See :class:`slgaussian.semantic.decode.Decoder`.
    alpha : float32 [H, W]
        Accumulated opacity in [0, 1].
    depth : float32 [H, W]
        z-depth in scene units, 0 where nothing is.
    """

    rgb: np.ndarray
    ids: np.ndarray
    confidence: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    field: SemanticField

    __repr__ = brief

    @property
    def reader(self) -> BankReader:
        """What turns texts into scores; the encoder is loaded when it is first asked."""
        return self.field.reader

    @cached_property
    def _objects(self) -> ObjectMap:
        return ObjectMap(self.ids, self.field.bank.ids)

    def query(self, text: str, **rules: Any) -> QueryResult:
        """Where ``text`` is in this view.

        ``rules``, such as ``threshold`` or ``protocol``, are those of
        :class:`slgaussian.language.query.Rules`.
        """
        return self.query_all([text], **rules)[0]

    def query_all(self, texts: Sequence[str], **rules: Any) -> list[QueryResult]:
        """Where each of ``texts`` is in this view, all asked at once; as :meth:`query`."""
        return ask(texts, self._objects, self.reader, Rules(**rules))

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """Which text fits each pixel best: int32 [H, W], 0 = no object, k + 1 = ``texts[k]``."""
        return segment(texts, self._objects, self.reader, Rules(**rules))


@dataclass(frozen=True, eq=False)
class SemanticField:
    """Gaussians that carry ID codes, and the memory bank that says what the codes mean.

    Attributes
    ----------
    gaussians : Gaussians
        With ``features``; see :class:`slgaussian.semantic.Lifting`.
    bank : MemoryBank
    cameras : mapping str -> Camera
        The context cameras by view name.
    settings : mapping
        Names and settings of every part that made the field, written into each artifact. Files are
        known by content there.
    places : {setting: path or name on the hub}
        Where the files of the encoder are, such as its ``model``. They are not part of the field.
    """

    gaussians: Gaussians
    bank: MemoryBank
    cameras: Mapping[str, Camera]
    settings: Mapping[str, Any]
    places: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        scene, encoder = (self.settings.get(name) for name in ("scene", "encoder"))
        of = "" if scene is None else f"{scene!r}: "
        held = f"{len(self.gaussians)} Gaussians, {len(self.bank)} objects"
        return f"SemanticField({of}{held}, views {said(tuple(self.cameras))}, encoder {encoder!r})"

    @cached_property
    def encoder(self) -> Encoder:
        """The text encoder that belongs to the bank, loaded when it is first asked for.

        Raises
        ------
        InputError
            If a file that it needs is not where ``places`` says, or is another one.
        SpecError
            If its vectors have another width than those of the bank.
        """
        part = Part.stored("encoder", self.settings, self.places)
        _check_places(part)
        encoder: Encoder = part.load(
            "is not what the field was built with; give that one, or build the field with it"
        )
        if self.bank.features.shape[2] != encoder.encode_text(encoder.canonical).shape[1]:
            raise SpecError(
                f"memory bank: made by another version of the encoder {part.name!r}; build the "
                "field again"
            )
        return encoder

    @cached_property
    def reader(self) -> BankReader:
        """Bank and encoder together: what turns texts into scores of objects."""
        return BankReader(self.bank, self.encoder)

    def query(
        self, texts: Sequence[str], cameras: Sequence[Camera], **rules: Any
    ) -> list[list[QueryResult]]:
        """Where each text is in each view: a list a camera, of a result a text.

        ``rules`` as in :meth:`FieldView.query`.
        """
        return [self.render(camera).query_all(texts, **rules) for camera in cameras]

    def describe(self, texts: Sequence[str], **rules: Any) -> list[Description]:
        """What is in the scene: every object with the best of ``texts``, whatever the view."""
        return describe(texts, self.reader, Rules(**rules))

    def render(self, camera: Camera, backend: str = "auto") -> FieldView:
        """See the field through ``camera``: colour, ids and depth in one pass."""
        values, rows = harmonics.colors(self.gaussians, camera), None
        if self.bank.dimension:
            values = torch.cat([values, self.gaussians.require_features()], 1)
        else:
            rows = self.gaussians.require_features()[:, 0].int()
        image = rasterize(self.gaussians, values, camera, backend=backend, labels=rows)
        drawn = image.values.float().numpy()
        if self.bank.dimension:
            ids, confidence = self._decoder(drawn[..., 3:])
        else:
            ids, confidence = elected_ids(image, self.bank.ids)
        alpha, depth = image.alpha.float().numpy(), image.depth.float().numpy()
        return FieldView(shown(drawn[..., :3], alpha), ids, confidence, alpha, depth, self)

    def changed(self, **parts: Any) -> SemanticField:
        """The same field with other ``parts``; an encoder that is loaded is not loaded again."""
        other = replace(self, **parts)
        if "encoder" in self.__dict__:
            other.__dict__["encoder"] = self.encoder
        return other

    @cached_property
    def _decoder(self) -> Decoder:
        return Decoder(self.bank)

    def labels(self) -> np.ndarray:
        """The object that each Gaussian carries most of all: int32 [N], 0 where it carries none."""
        features = self.gaussians.require_features().numpy()
        if not self.bank.dimension:
            return np.append(np.int32(0), self.bank.ids)[features[:, 0].astype(np.int64)]
        labelled = features[:, -1] >= VISIBLE
        ids = np.zeros(len(features), np.int32)
        if labelled.any():
            rows = nearest_code(features[labelled, :-1] / features[labelled, -1:], self.bank.codes)
            ids[labelled] = self.bank.ids[rows]
        return ids

    def objects(self) -> pa.Table:
        """One row an object: its id, its code and how many Gaussians carry it most of all."""
        labels = self.labels()
        rows = np.searchsorted(self.bank.ids, labels[labels > 0])  # ids are positive and ascending
        counts = np.bincount(rows, minlength=len(self.bank.ids))
        columns: dict[str, Any] = {"id": self.bank.ids.astype(np.int64)}
        for channel, letter in enumerate("rgb"):
            known = channel < self.bank.dimension
            column = self.bank.codes[:, channel].astype(np.float64) if known else None
            columns[f"code_{letter}"] = pa.nulls(len(self.bank)) if column is None else column
        columns["gaussians"] = counts.astype(np.int64)
        return pa.table(columns, schema=load_spec("objects").schema)

    def contents(self) -> dict[str, Arrays | pa.Table]:
        """What the files of a field hold, by the data spec of each."""
        return {
            "gaussians": self.gaussians.to_arrays(),
            "bank": self.bank.to_arrays(),
            "objects": self.objects(),
        }

    def about(self, digests: Mapping[str, str]) -> About:
        """What the field says of itself, given the digests of its contents by spec."""
        return About(self.settings, self.cameras, digests)

    def save(self, path: str | Path, beside: Mapping[str, bytes] | None = None) -> None:
        """Write the field to folder ``path``: complete, or not at all.

        A field that is there already is replaced. See :mod:`slgaussian.storage.field_folder`;
        ``beside`` are further files of the folder by name, which no question needs.

        Raises
        ------
        InputError
            If the folder cannot be written, or holds something that is not a field.
        """
        path = Path(path)
        field_folder.check_target(path)
        files = {
            spec: packed(spec, content, field_folder.FILES[spec])
            for spec, content in self.contents().items()
        }
        about = self.about({spec: digest for spec, (digest, _) in files.items()})
        field_folder.write(
            path,
            about.to_json(self.places),
            lambda spec, file: file.write_bytes(files[spec][1]),
            beside,
        )

    @staticmethod
    def load(path: str | Path, encoder: Mapping[str, str | Path] | None = None) -> SemanticField:
        """Read a field folder.

        Parameters
        ----------
        path : path or str
        encoder : {setting: path or name on the hub}, optional
            Where the files of its encoder are now, if not where they were when it was built, as in
            ``{"model": "models/clip"}``. They are looked at when the field is first asked.

        Raises
        ------
        SpecError
            If a file of it is missing or damaged, or the encoder is no longer that of the bank;
            the message names the file.
        """
        compiling.watch()
        path = Path(path)
        about, where = field_folder.read_about(path)
        where |= {key: str(place) for key, place in (encoder or {}).items()}
        arrays = {
            spec: field_folder.read_arrays(path, spec, about.digests[spec])
            for spec in ("gaussians", "bank")
        }
        try:
            loaded = SemanticField.of(about, arrays, where)
        except InputError as error:
            raise SpecError(f"{path}{os.sep}{error}; {field_folder.AGAIN}") from error
        try:
            if not Part.stored("encoder", about.settings).files:
                loaded.encoder  # noqa: B018  (what needs no files is checked at once)
        except (InputError, SpecError) as error:
            raise SpecError(f"{path}: {error}") from error
        return loaded

    @staticmethod
    def of(
        about: About, arrays: Mapping[str, Arrays], places: Mapping[str, str] | None = None
    ) -> SemanticField:
        """The field that ``about`` describes, of the arrays of ``gaussians`` and ``bank``.

        Raises
        ------
        InputError
            If the arrays hold none, or do not belong together; the message begins with the file.
        """
        with _naming_file("gaussians"):
            gaussians = Gaussians.from_arrays(arrays["gaussians"])
        with _naming_file("bank"):
            bank = MemoryBank.from_arrays(arrays["bank"])
        _check_features(gaussians, bank)
        return SemanticField(gaussians, bank, about.cameras, about.settings, places or {})


@contextmanager
def _naming_file(spec: str) -> Iterator[None]:
    """Begin the message of an InputError with the file of a field that holds ``spec``."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{field_folder.FILES[spec]}: {error}") from error


def shown(drawn: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The picture uint8 [H, W, 3] of composited colours float [H, W, 3] and ``alpha`` [H, W].

    Mean colour of what is there; it fades to black where ``alpha`` is below :data:`VISIBLE`.
    """
    colour = drawn / np.maximum(alpha, VISIBLE)[..., None]
    return np.rint(colour.clip(0, 1) * 255).astype(np.uint8)


def _check_places(encoder: Part) -> None:
    """InputError if a file of the encoder has no place, or is no longer there."""
    for key, known in encoder.files.items():
        place = known.place
        if not place or (os.path.isabs(place) and not os.path.exists(place)):
            gone = f" and is no longer at {place}" if place else ""
            raise InputError(
                f"the field's encoder {encoder.name!r} needs its {key}, which is not stored with a "
                f"field{gone}; say where it is, as in --{encoder.name}-{key} PLACE or "
                f"SemanticField.load(..., encoder={{'{key}': PLACE}})"
            )


def _check_features(gaussians: Gaussians, bank: MemoryBank) -> None:
    file, wide = field_folder.FILES["gaussians"], bank.dimension + 1
    if gaussians.features is None or gaussians.features.shape[1] != wide:
        raise InputError(f"{file}: no features [N, {wide}]")
    if bank.dimension == 0:
        rows = gaussians.features[:, 0]
        if not ((rows >= 0) & (rows <= len(bank)) & (rows == rows.round())).all():
            raise InputError(f"{file}: features are no rows of a bank of {len(bank)} objects")
