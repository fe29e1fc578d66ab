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
from slgaussian.edits import Edits, find_hidden
from slgaussian.errors import InputError, SpecError, check_type
from slgaussian.field_view import FieldView, add_stripes, mean_colour, render_values
from slgaussian.gaussians import Gaussians
from slgaussian.io import short
from slgaussian.language import Encoder, restore_encoder
from slgaussian.language.answer import QueryResult, ask
from slgaussian.language.bank import MemoryBank
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader
from slgaussian.language.taught import encoder_identity
from slgaussian.language.wholes import MIN_PIXELS
from slgaussian.scene import Camera
from slgaussian.storage import field_folder
from slgaussian.storage.encoding import Arrays, encode_artifact
from slgaussian.storage.field_folder import About
from slgaussian.storage.provenance import Provenance, record_provenance

if TYPE_CHECKING:
    import pyarrow as pa

    from slgaussian.objects import SceneObject
    from slgaussian.semantic.decode import Decoder


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
        """The text encoder, which :func:`slgaussian.language.restore_encoder` loads when needed."""
        return restore_encoder(self.settings, self.places, self.bank.features.shape[2])

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

        ``texts`` describe objects, in addition to taught words; by default they are
        :attr:`slgaussian.language.Encoder.describing`. ``rules``, as in :meth:`FieldView.query`,
        affect only the relevancies. InputError if a text cannot be used.
        """
        from slgaussian.objects import list_objects

        return list_objects(self, texts, Rules(**rules))

    def render(self, camera: Camera, backend: str = "auto") -> FieldView:
        """Render colour, object ids and depth for ``camera`` in one pass.

        ``backend`` as in :func:`slgaussian.rasterize.rasterize`.
        """
        check_type(camera, Camera, "render: expected a Camera, such as sample.context[0].camera")
        image = render_values(self.visible, camera, backend)
        ids, confidence = self._decoder(image.values[..., 3:])
        # A splat of another program was optimised on black: a mean would be too bright by 3 dB.
        opacity = image.alpha if self.gaussians.pixelwise else np.ones_like(image.alpha)
        rgb = mean_colour(image.values[..., :3], opacity)
        if self.edits.removed:
            rgb = add_stripes(rgb, image.alpha)
        return FieldView(rgb, ids, confidence, image.alpha, image.depth, self, camera)

    def render_codes(self, camera: Camera, backend: str = "auto") -> np.ndarray:
        """Render the semantic feature map F (paper, equation 3), float32 [H, W, 3].

        Codes are multiplied by blending weights, so they are 0 where the view is empty.
        """
        return render_values(self.visible, camera, backend).values[..., 3:-1]

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

    def teach(self, word: str, object_id: int) -> SemanticField:
        """Return the field with an object as an example of ``word``.

        The other objects of the field become its rivals. See :mod:`slgaussian.language.taught`.
        InputError if there is no such object, or the word is empty or too long.
        """
        identity = encoder_identity(self.settings)
        return self.with_changes(edits=self.edits.teach(word, object_id, self.bank, identity))

    def forget(self, word: str) -> SemanticField:
        """Return the field without a taught word; InputError if it is not taught."""
        return self.with_changes(edits=self.edits.forget(word))

    def rename(self, object_id: int, name: str) -> SemanticField:
        """Return the field with a name for an object; an empty name deletes it.

        InputError if there is no such object, or the name is too long.
        """
        return self.with_changes(edits=self.edits.rename(object_id, name, self.bank))

    def without(self, ids: Iterable[int]) -> SemanticField:
        """Return the field with these objects removed; InputError if one does not exist."""
        return self.with_changes(edits=self.edits.hide(ids, self.bank))

    def restore(self, ids: Iterable[int]) -> SemanticField:
        """Return the field with these objects restored.

        InputError if one does not exist, or its Gaussians are no longer in the field.
        """
        return self.with_changes(edits=self.edits.restore(ids, self.bank, self.labels()))

    def drop_hidden(self) -> SemanticField:
        """Return the field without the Gaussians of removed objects, which is not reversible."""
        return self.with_changes(gaussians=self.visible)

    def only(self, ids: Iterable[int]) -> SemanticField:
        """Return the field with only the Gaussians of these objects; InputError if one is none."""
        chosen = np.isin(self.labels(), list(self.bank.check_ids(ids)))
        return self.with_changes(gaussians=self.gaussians[chosen])

    @cached_property
    def visible(self) -> Gaussians:
        """The Gaussians without those that are :attr:`hidden`."""
        return self.gaussians[~self.hidden] if self.hidden.any() else self.gaussians

    @cached_property
    def hidden(self) -> np.ndarray:
        """bool [N]: the Gaussians of removed objects and along their boundaries."""
        return find_hidden(self, self._whole_views)

    @cached_property
    def _whole_views(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Ids and depth of context views with all objects: fields with other edits share them."""
        return {}

    @cached_property
    def _decoder(self) -> Decoder:
        from slgaussian.semantic.decode import make_decoder

        return make_decoder(self.bank, self.settings)

    def labels(self) -> np.ndarray:
        """Return the main object of each Gaussian: int32 [N], 0 for none."""
        return self._labels

    @cached_property
    def _labels(self) -> np.ndarray:
        from slgaussian.semantic.decode import find_labels

        return find_labels(self.gaussians.to_arrays()["features"], self.bank)

    def contents(self) -> dict[str, Arrays | pa.Table]:
        """Return the contents of the files of a field, by data spec."""
        return {
            "gaussians": self.gaussians.to_arrays(),
            "bank": self.bank.to_arrays(),
            "objects": field_folder.tabulate_objects(self.bank.ids, self.bank.codes, self.labels()),
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
        about = About(self.settings, self.cameras, {spec: file[0] for spec, file in files.items()})
        field_folder.write(
            Path(path),
            about.to_json(self.places),
            lambda spec, file: file.write_bytes(files[spec][1]),
            {**(beside or {}), **self.edits.to_files()},
        )

    def save_edits(self, path: str | Path) -> None:
        """Write only taught words, names and removed objects to the folder of this field.

        InputError if the folder holds another field or cannot be written, SpecError if it is
        damaged.
        """
        self.edits.write(Path(path), self.bank)

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
        arrays = field_folder.read_arrays(path, about.digests)
        try:
            built = SemanticField.from_arrays(about, arrays, places)
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
    def from_arrays(
        about: About, arrays: Mapping[str, Arrays], places: Mapping[str, str] | None = None
    ) -> SemanticField:
        """Make a field from its metadata and the arrays of ``gaussians`` and ``bank``.

        Raises:
            InputError: If the arrays are invalid or do not match; the message begins with the file.
        """
        try:
            bank = MemoryBank.from_arrays(arrays[spec := "bank"])
            gaussians = Gaussians.from_arrays(arrays[spec := "gaussians"])
            features = gaussians.to_arrays().get("features")
            if features is None or features.shape[1:] != (4,):
                raise InputError("no features [N, 4]")
        except InputError as error:
            raise InputError(f"{field_folder.FILES[spec]}: {error}") from error
        return SemanticField(gaussians, bank, about.cameras, about.settings, places or {})
