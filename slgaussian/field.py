"""The semantic field: rendering, queries, edits, saving and loading."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian.components.registry import restore
from slgaussian.edits import Edits
from slgaussian.errors import InputError, SpecError, check_type
from slgaussian.gaussians import Gaussians
from slgaussian.io import short, short_repr
from slgaussian.labels import MIN_WEIGHT
from slgaussian.language import Encoder
from slgaussian.language.answer import QueryResult, ask, segment
from slgaussian.language.bank import MemoryBank
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader
from slgaussian.language.taught import TaughtWords, encoder_identity
from slgaussian.language.wholes import MIN_PIXELS
from slgaussian.scene import Camera
from slgaussian.semantic.boundary_gaussians import boundary_gaussians
from slgaussian.storage import field_folder
from slgaussian.storage.encoding import Arrays, arrays_digest, encode_artifact
from slgaussian.storage.field_folder import About
from slgaussian.storage.provenance import Provenance, record_provenance
from slgaussian.storage.specs import load_spec

if TYPE_CHECKING:
    import pyarrow as pa

    from slgaussian.objects import SceneObject
    from slgaussian.rasterize.picture import Picture
    from slgaussian.semantic.decode import Decoder, NearestCode

HATCH_WIDTH = 5
"""Width in pixels of a stripe of the pattern for unknown pixels."""

HATCH_GREYS = np.array([96, 160], np.uint8)
"""The two greys of the pattern."""


@dataclass(frozen=True, eq=False)
class FieldView:
    """A semantic field rendered for one camera.

    Attributes:
        rgb: uint8 [H, W, 3]. Mean colour of the Gaussians; fades to black where ``alpha`` is below
            :data:`MIN_WEIGHT`.
        ids: int32 [H, W]. Object ids, 0 for none.
        confidence: float32 [H, W]. In [0, 1], about the blending weight of the object minus that of
            the next one; 0 without an object. See :class:`slgaussian.semantic.decode.Decoder`.
        alpha: float32 [H, W]. Accumulated opacity in [0, 1].
        depth: float32 [H, W]. z-depth in scene units, 0 where empty.
        field: The rendered field.
        camera: The camera.
    """

    rgb: np.ndarray
    ids: np.ndarray
    confidence: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    field: SemanticField
    camera: Camera | None = None

    __repr__ = short_repr

    @property
    def reader(self) -> BankReader:
        """Reader that scores texts."""
        return self.field.reader

    @property
    def unknown(self) -> np.ndarray:
        """bool [H, W]: pixels without Gaussians.

        They are behind removed objects and outside the photographs. They are not inpainted; after
        a removal ``rgb`` has a pattern of stripes there.
        """
        return self.alpha < MIN_WEIGHT

    @cached_property
    def _objects(self) -> ObjectMap:
        return ObjectMap(self.ids, self.field.bank.ids)

    def query(self, text: str, **rules: Any) -> QueryResult:
        """Find ``text`` in this view.

        ``rules``, such as ``threshold``, are those of :class:`slgaussian.language.rules.Rules`.
        """
        check_type(text, str, "query: expected one text; query_all takes a list of them")
        return self.query_all([text], **rules)[0]

    def query_all(self, texts: Sequence[str], **rules: Any) -> list[QueryResult]:
        """Find each of ``texts`` in this view; as :meth:`query`."""
        return ask(texts, self._objects, self.reader, Rules(**rules))

    def like(self, image: np.ndarray, mask: np.ndarray | None = None, **rules: Any) -> QueryResult:
        """Find objects that are similar to a picture uint8 [H, W, 3]; as :meth:`query`.

        ``mask``, bool [H, W], selects the object in the picture; by default it is the whole one.
        """
        check_type(image, np.ndarray, "like: expected a picture, uint8 [H, W, 3]")
        encoder, (_, features) = self.field.encoder, self.field.bank.mean_features()
        example, word = encode_picture(encoder, image, mask), "the picture"
        taught = TaughtWords().add_example(word, example, features, encoder.name)
        reader = BankReader(self.field.bank, encoder, taught)
        answer = ask([word], self._objects, reader, Rules(**rules))[0]
        return replace(answer, understood=replace(answer.understood, kind="picture", instead_of=""))

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """Label each pixel with the text that fits it best: int32 [H, W], k + 1 = ``texts[k]``.

        0 means no object, or no text with a relevancy above the ``threshold`` of the rules, by
        default 0.5. The command ``segment`` uses this method.
        """
        return segment(texts, self._objects, self.reader, Rules(**rules))


@dataclass(frozen=True, eq=False)
class SemanticField:
    """Gaussians with ID codes, and the memory bank with the features of each code's object.

    Attributes:
        gaussians: With ``features``; see :class:`slgaussian.semantic.Lifting`.
        cameras: mapping str -> Camera. The context cameras by view name.
        settings: Names and settings of all components that built the field, written into each
            artifact. Files are identified by their content.
        places: {setting: path or name on the hub}. Location of the encoder's files, such as its
            ``model``, which are not part of the field.
        edits: Words, names and removals of the user.
    """

    gaussians: Gaussians
    bank: MemoryBank
    cameras: Mapping[str, Camera]
    settings: Mapping[str, Any]
    places: Mapping[str, str] = field(default_factory=dict)
    edits: Edits = field(default_factory=Edits)

    def __repr__(self) -> str:
        scene, encoder = (self.settings.get(name) for name in ("scene", "encoder"))
        title = "" if scene is None else f"{scene!r}: "
        sizes = f"{len(self.gaussians)} Gaussians, {len(self.bank)} objects"
        views = short(tuple(self.cameras))
        return f"SemanticField({title}{sizes}, views {views}, encoder {encoder!r})"

    @cached_property
    def encoder(self) -> Encoder:
        """The text encoder of the bank, loaded on first access.

        Raises:
            InputError: If one of its files is missing from ``places`` or has another content.
            SpecError: If its vectors have another dimension than those of the bank.
        """
        component = restore("encoder", self.settings, self.places)
        for key, file in component.known_files.items():
            place = file.place
            if not place or (os.path.isabs(place) and not os.path.exists(place)):
                moved = f" and is no longer at {place}" if place else ""
                raise InputError(
                    f"the field's encoder {component.name!r} needs its {key}, which is not stored "
                    f"with a field{moved}; say where it is, as in --set {component.name}.{key}="
                    f"PLACE or SemanticField.load(..., encoder={{'{key}': PLACE}})"
                )
        encoder: Encoder = component.load(
            "is not what the field was built with; give that one, or build the field with it"
        )
        if self.bank.features.shape[2] != encoder.encode_text(encoder.canonical).shape[1]:
            raise SpecError(
                f"memory bank: made by another version of the encoder {component.name!r}; build "
                "the field again"
            )
        return encoder

    @cached_property
    def reader(self) -> BankReader:
        """Reader that scores texts against the objects of the bank."""
        return BankReader(self.bank, self.encoder, self.edits.taught, self.edits.names)

    def query(self, text: str, camera: Camera | None = None, **rules: Any) -> QueryResult:
        """Find ``text`` in the view of a camera, by default that of the first context view.

        ``rules`` as in :meth:`FieldView.query`. For several texts, render once and use
        :meth:`FieldView.query_all`.
        """
        return self.render(camera or next(iter(self.cameras.values()))).query(text, **rules)

    def find(self, text: str, **rules: Any) -> tuple[tuple[int, float], ...]:
        """Find the objects of ``text`` independently of a view: (id, relevancy), best first.

        ``rules`` as in :meth:`FieldView.query`.
        """
        remaining = ~np.isin(self.bank.ids, list(self.edits.removed))
        # As in an image that shows enough of each.
        image = ObjectMap(self.bank.ids[None], self.bank.ids, MIN_PIXELS * remaining)
        return ask([text], image, self.reader, Rules(**rules), remaining)[0].objects

    def inventory(self, texts: Sequence[str] | None = None, **rules: Any) -> list[SceneObject]:
        """List every object with its best words, position and size, by id.

        Args:
            texts: sequence of str, optional. Texts that describe objects, in addition to taught
                words. By default :attr:`slgaussian.language.Encoder.describing`.
            rules: As in :meth:`FieldView.query`; they affect only the relevancies.

        Raises:
            InputError: If a text cannot be used.
        """
        from slgaussian.objects import list_objects

        return list_objects(self, self.best_words(texts, **rules))

    def best_words(
        self, texts: Sequence[str] | None = None, **rules: Any
    ) -> list[tuple[tuple[str, float], ...]]:
        """Return the best texts of each object of the bank, with relevancies, best first.

        Arguments as for :meth:`inventory`.
        """
        from slgaussian.objects import MAX_DESCRIBING_WORDS

        words = list(dict.fromkeys([*self.edits.taught, *(texts or self.encoder.describing)]))
        relevancies = self.reader.relevancies(words, Rules(**rules)).T
        best = np.argsort(-relevancies, axis=1, kind="stable")[:, :MAX_DESCRIBING_WORDS]
        return [
            tuple((words[k], float(scores[k])) for k in rows)
            for scores, rows in zip(relevancies, best, strict=True)
        ]

    def render(self, camera: Camera, backend: str = "auto") -> FieldView:
        """Render colour, object ids and depth for ``camera`` in one pass.

        ``backend`` as in :func:`slgaussian.rasterize.rasterize`.
        """
        check_type(camera, Camera, "render: expected a Camera, such as sample.context[0].camera")
        image = self._picture(camera, backend)
        ids, confidence = self._decoder(image.values[..., 3:])
        rgb = mean_colour(image.values[..., :3], image.alpha)
        if self.edits.removed:
            stripe = np.indices(rgb.shape[:2]).sum(0) // HATCH_WIDTH % 2
            rgb = np.where(
                (image.alpha < MIN_WEIGHT)[..., None], HATCH_GREYS[stripe][..., None], rgb
            )
        return FieldView(rgb, ids, confidence, image.alpha, image.depth, self, camera)

    def render_codes(self, camera: Camera, backend: str = "auto") -> np.ndarray:
        """Render the semantic feature map F (paper, equation 3), float32 [H, W, 3].

        Codes are multiplied by blending weights, so they are 0 where the view is empty.
        """
        return self._picture(camera, backend).values[..., 3:-1]

    def _picture(self, camera: Camera, backend: str) -> Picture:
        """Render colours, codes and their weight, as arrays on the CPU."""
        from slgaussian.rasterize.picture import Picture, compute_view_colours, picture

        gaussians = self.visible
        if backend == "cpu" or (backend == "auto" and not gaussians.is_cuda):
            values, features = (
                compute_view_colours(gaussians, camera),
                gaussians.to_arrays()["features"],
            )
            return picture(gaussians, np.concatenate([values, features], 1), camera)
        import torch

        from slgaussian.rasterize import harmonics, rasterize

        colours, codes = harmonics.compute_colours(gaussians, camera), gaussians.require_features()
        drawn = torch.cat([colours, codes], 1)
        return Picture.of(rasterize(gaussians, drawn, camera, backend=backend))

    def with_changes(self, **parts: Any) -> SemanticField:
        """Return the field with ``parts`` replaced; cached results that stay valid are shared."""
        result = replace(self, **parts)
        valid = {"encoder"}
        if result.gaussians is self.gaussians and result.bank is self.bank:
            valid |= {"_decoder", "_labels"}
            if result.cameras is self.cameras:
                valid |= {"_whole_views"}
                if result.edits.removed == self.edits.removed:
                    valid |= {"hidden", "visible"}
        result.__dict__.update({name: self.__dict__[name] for name in valid & self.__dict__.keys()})
        return result

    def _edit(self, **edits: Any) -> SemanticField:
        return self.with_changes(edits=replace(self.edits, **edits))

    def teach(self, word: str, object_id: int) -> SemanticField:
        """Return the field with an object as an example of ``word``.

        The other objects of the field become its rivals. See :mod:`slgaussian.language.taught`.

        Raises:
            InputError: If there is no such object, or the word is empty or too long.
        """
        row, (rows, features) = self.bank.row(object_id), self.bank.mean_features()
        if row not in rows:
            raise InputError(f"object {object_id}: no view holds it, so it is like nothing")
        lesson = features[rows == row][0], features[rows != row], encoder_identity(self.settings)
        return self._edit(taught=self.edits.taught.add_example(word, *lesson))

    def forget(self, word: str) -> SemanticField:
        """Return the field without a taught word; InputError if it is not taught."""
        return self._edit(taught=self.edits.taught.remove(word))

    def rename(self, object_id: int, name: str) -> SemanticField:
        """Return the field with a name for an object; an empty name deletes it.

        InputError if there is no such object, or the name is too long.
        """
        self.bank.row(object_id)
        return self.with_changes(edits=self.edits.rename(object_id, name))

    def without(self, ids: Iterable[int]) -> SemanticField:
        """Return the field with these objects removed; InputError if one does not exist."""
        return self._edit(removed=self.edits.removed | self._check_ids(ids))

    def restore(self, ids: Iterable[int]) -> SemanticField:
        """Return the field with these objects restored.

        InputError if one does not exist, or its Gaussians are no longer in the field.
        """
        restored = self._check_ids(ids)
        if missing := restored - set(self.labels().tolist()):
            raise InputError(
                f"object {min(missing)}: its Gaussians are not in this field; open the one that it "
                "was removed from"
            )
        return self._edit(removed=self.edits.removed - restored)

    def drop_hidden(self) -> SemanticField:
        """Return the field without the Gaussians of removed objects, which is not reversible."""
        return self.with_changes(gaussians=self.visible)

    def only(self, ids: Iterable[int]) -> SemanticField:
        """Return the field with only the Gaussians of these objects; InputError if one is none."""
        chosen = np.isin(self.labels(), list(self._check_ids(ids)))
        return self.with_changes(gaussians=self.gaussians[chosen])

    def _check_ids(self, ids: Iterable[int]) -> frozenset[int]:
        return frozenset(int(self.bank.ids[self.bank.row(id_)]) for id_ in ids)

    @cached_property
    def visible(self) -> Gaussians:
        """The Gaussians without those that are :attr:`hidden`."""
        return self.gaussians[~self.hidden] if self.hidden.any() else self.gaussians

    @cached_property
    def hidden(self) -> np.ndarray:
        """bool [N]: the Gaussians of removed objects and along their boundaries."""
        ids = list(self.edits.removed)
        hidden = np.isin(self.labels(), ids)
        if not hidden.any():
            return hidden
        views = np.flatnonzero(self.bank.present[np.isin(self.bank.ids, ids)].any(0))
        cameras = {name: c for i, (name, c) in enumerate(self.cameras.items()) if i in views}
        for name in cameras.keys() - self._whole_views.keys():
            view = self._edit(removed=frozenset()).render(cameras[name])
            self._whole_views[name] = view.ids, view.depth
        depths = [self._whole_views[name][1] for name in cameras]
        masks = [np.isin(self._whole_views[name][0], ids) for name in cameras]
        means = self.gaussians.to_arrays()["means"]
        local_cameras = [self.gaussians.localize(camera) for camera in cameras.values()]
        return hidden | boundary_gaussians(means, hidden, local_cameras, depths, masks)

    @cached_property
    def _whole_views(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Ids and depth of context views with all objects: fields with other edits share them."""
        return {}

    @cached_property
    def _decoder(self) -> Decoder | NearestCode:
        from slgaussian.semantic.decode import make_decoder

        return make_decoder(self.bank, self.settings)

    def labels(self) -> np.ndarray:
        """Return the main object of each Gaussian: int32 [N], 0 for none."""
        return self._labels

    @cached_property
    def _labels(self) -> np.ndarray:
        features = self.gaussians.to_arrays()["features"]
        labelled = features[:, -1] >= MIN_WEIGHT
        ids = np.zeros(len(features), np.int32)
        if labelled.any():
            from slgaussian.language.nearest import nearest_code

            rows = nearest_code(features[labelled, :-1] / features[labelled, -1:], self.bank.codes)
            ids[labelled] = self.bank.ids[rows]
        return ids

    def objects(self) -> pa.Table:
        """Return a table of the objects: id, code and number of Gaussians with this main object."""
        import pyarrow as pa

        labels = self.labels()
        rows = np.searchsorted(self.bank.ids, labels[labels > 0])  # ids are positive and ascending
        counts = np.bincount(rows, minlength=len(self.bank.ids))
        columns = [self.bank.ids.astype(np.int64), *self.bank.codes.T.astype(np.float64), counts]
        return pa.table(columns, schema=load_spec("objects").schema)

    def contents(self) -> dict[str, Arrays | pa.Table]:
        """Return the contents of the files of a field, by data spec."""
        return {
            "gaussians": self.gaussians.to_arrays(),
            "bank": self.bank.to_arrays(),
            "objects": self.objects(),
        }

    def provenance(self) -> Provenance:
        """Return the provenance for files of fields that no stage of a run has built."""
        results = ("account", "quality", "verdict")
        settings = {name: value for name, value in self.settings.items() if name not in results}
        return Provenance("build_field", settings=json.loads(json.dumps(settings, sort_keys=True)))

    def save(self, path: str | Path, beside: Mapping[str, bytes] | None = None) -> None:
        """Write the field atomically to the folder ``path``, replacing a field that is there.

        See :mod:`slgaussian.storage.field_folder`; ``beside`` are additional files by name. After
        edits alone (taught words, names, removals) :meth:`save_edits` is enough.

        Raises:
            InputError: If the folder cannot be written, or holds something that is not a field.
        """
        field_folder.check_target(Path(path))
        with record_provenance(self.provenance()):
            files = {
                spec: encode_artifact(spec, content, field_folder.FILES[spec])
                for spec, content in self.contents().items()
            }
        digests = {spec: digest for spec, (digest, _) in files.items()}
        about = About(self.settings, self.cameras, digests)
        field_folder.write(
            Path(path),
            about.to_json(self.places),
            lambda spec, file: file.write_bytes(files[spec][1]),
            {**(beside or {}), **self.edits.to_files()},
        )

    def save_edits(self, path: str | Path) -> None:
        """Write only taught words, names and removed objects to the folder of this field.

        Raises:
            InputError: If the folder holds another field, or cannot be written.
            SpecError: If it is damaged.
        """
        about, _ = field_folder.read_about(Path(path))
        if about.digests["bank"] != arrays_digest(self.bank.to_arrays()):
            raise InputError(f"{path}: is the folder of another field; save this one as a whole")
        self.edits.write(Path(path))

    @staticmethod
    def load(path: str | Path, encoder: Mapping[str, str | Path] | None = None) -> SemanticField:
        """Read a field folder.

        Args:
            encoder: {setting: path or name on the hub}, optional. Current location of its encoder's
                files, if it has changed since the field was built, as in ``{"model":
                "models/clip"}``. They are read by the first query.

        Raises:
            SpecError: If a file is missing or damaged, or the encoder does not match the bank; the
                message names the file.
        """
        path = Path(path)
        about, places = field_folder.read_about(path)
        places |= {key: str(place) for key, place in (encoder or {}).items()}
        arrays = {
            spec: field_folder.read_arrays(path, spec, about.digests[spec])
            for spec in ("bank", "gaussians")
        }
        try:
            built = SemanticField.of(about, arrays, places)
        except InputError as error:
            raise SpecError(f"{path}{os.sep}{error}; {field_folder.REPAIR}") from error
        identity = encoder_identity(about.settings)
        loaded = replace(built, edits=Edits.read(path, identity, built.bank.ids))
        try:
            if not restore("encoder", about.settings).known_files:
                loaded.encoder  # noqa: B018  (checked at once if it needs no files)
        except (InputError, SpecError) as error:
            raise SpecError(f"{path}: {error}") from error
        return loaded

    @staticmethod
    def of(
        about: About, arrays: Mapping[str, Arrays], places: Mapping[str, str] | None = None
    ) -> SemanticField:
        """Make a field from its metadata and the arrays of ``gaussians`` and ``bank``.

        Raises:
            InputError: If the arrays are invalid or do not match; the message begins with the file.
        """
        spec = "bank"
        try:
            bank = MemoryBank.from_arrays(arrays[spec])
            spec = "gaussians"
            gaussians = Gaussians.from_arrays(arrays[spec])
            features = gaussians.to_arrays().get("features")
            if features is None or features.shape[1:] != (4,):
                raise InputError("no features [N, 4]")
        except InputError as error:
            raise InputError(f"{field_folder.FILES[spec]}: {error}") from error
        return SemanticField(gaussians, bank, about.cameras, about.settings, places or {})


def mean_colour(drawn: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Convert composited colours float [H, W, 3] and ``alpha`` [H, W] to uint8 [H, W, 3].

    Computes the mean colour, faded to black where ``alpha`` is below :data:`MIN_WEIGHT`.
    """
    colour = drawn / np.maximum(alpha, MIN_WEIGHT)[..., None]
    return np.rint(colour.clip(0, 1) * 255).astype(np.uint8)


def encode_picture(encoder: Encoder, image: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Encode the object in a picture; arguments as for :meth:`FieldView.like`.

    Returns:
        float32 [C]. A unit vector.

    Raises:
        InputError: If picture or mask have another shape or type, or the mask is empty.
    """
    region, size = np.ones(image.shape[:2], bool) if mask is None else mask, image.shape[:2]
    if image.dtype != np.uint8 or image.shape != (*size, 3):
        raise InputError(f"picture: found {image.dtype} {image.shape}, expected uint8 [H, W, 3]")
    if region.dtype != bool or region.shape != size:
        raise InputError(
            f"picture: its mask is {region.dtype} {region.shape}, expected bool {size}"
        )
    if not region.any():
        raise InputError("picture: its mask is empty; give one that shows a thing")
    rows, columns = (np.flatnonzero(region.any(axis)) for axis in (1, 0))
    frame = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return encoder.encode_regions(np.ascontiguousarray(image[frame]), region[frame][None])[0]
