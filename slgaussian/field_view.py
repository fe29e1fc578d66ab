"""A view of a semantic field: its pixels, and the answers to texts and pictures in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from slgaussian.errors import InputError, check_type
from slgaussian.gaussians import Gaussians
from slgaussian.io import short_repr
from slgaussian.labels import MIN_WEIGHT
from slgaussian.language import Encoder
from slgaussian.language.answer import QueryResult, ask, segment
from slgaussian.language.objectmap import ObjectMap
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import BankReader
from slgaussian.language.taught import TaughtWords
from slgaussian.scene import Camera

if TYPE_CHECKING:
    from slgaussian.field import SemanticField
    from slgaussian.rasterize.picture import Picture

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


def render_values(gaussians: Gaussians, camera: Camera, backend: str) -> Picture:
    """Render colours, codes and their weight: ``values`` float32 [H, W, 7], on the CPU.

    ``backend`` as in :func:`slgaussian.rasterize.rasterize`.
    """
    from slgaussian.rasterize.picture import Picture, compute_view_colours, picture

    if backend == "cpu" or (backend == "auto" and not gaussians.is_cuda):
        drawn = compute_view_colours(gaussians, camera), gaussians.to_arrays()["features"]
        return picture(gaussians, np.concatenate(drawn, 1), camera)
    import torch

    from slgaussian.rasterize import harmonics, rasterize

    tensors = harmonics.compute_colours(gaussians, camera), gaussians.require_features()
    return Picture.of(rasterize(gaussians, torch.cat(tensors, 1), camera, backend=backend))


def mean_colour(drawn: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Compute the mean colour uint8 [H, W, 3] of composited colours float [H, W, 3].

    It fades to black where ``alpha`` [H, W] is below :data:`MIN_WEIGHT`.
    """
    colour = drawn / np.maximum(alpha, MIN_WEIGHT)[..., None]
    return np.rint(colour.clip(0, 1) * 255).astype(np.uint8)


def add_stripes(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return ``rgb`` uint8 [H, W, 3] with a pattern of stripes where there are no Gaussians."""
    stripe = np.indices(alpha.shape).sum(0) // HATCH_WIDTH % 2
    return np.where((alpha < MIN_WEIGHT)[..., None], HATCH_GREYS[stripe][..., None], rgb)


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
