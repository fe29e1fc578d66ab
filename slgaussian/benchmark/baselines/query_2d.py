"""The paper's 2D query (Table 4): the novel view is rendered, segmented and encoded as an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slgaussian.benchmark.baselines.dense import Picture, draw_picture
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.field_view import FieldView
from slgaussian.geometry import SeenView
from slgaussian.labels import MIN_WEIGHT, LabelMaps
from slgaussian.language.answer import QueryResult
from slgaussian.language.scoring import TextReader
from slgaussian.masks.flatten import flatten
from slgaussian.scene import Camera, View


@dataclass(frozen=True)
class Query2d:
    """Render colours, then process the image like a photograph.

    Nothing is prepared: proposals and encoding are part of the first query of a view, as in the
    paper's 18 s per query. Empty pixels are not segmented. With ``depth``, proposer and encoder get
    the rendered depth and groups of objects, as in the field; the paper's get the image only.
    """

    depth: bool = False

    def __call__(self, inputs: Inputs) -> Pictures:
        """Prepare nothing; InputError if the encoder does not encode images."""
        image = inputs.sample.context[0].image
        inputs.encoder.encode_regions(image, np.zeros((0, *image.shape[:2]), bool))
        return Pictures(inputs, self.depth)


@dataclass(frozen=True, eq=False)
class Pictures:
    """A scene that is rendered to images, with or without depth."""

    inputs: Inputs
    with_depth: bool

    def render(self, camera: Camera) -> PictureView:
        """Render colours."""
        picture = draw_picture(self.inputs.gaussians, camera)
        return PictureView(self, camera, picture, picture.rgb, picture.depth, self.inputs.reader)


@dataclass(frozen=True, eq=False)
class PictureView:
    """A rendered image, segmented and encoded at the first query."""

    scene: Pictures
    camera: Camera
    picture: Picture
    rgb: np.ndarray
    depth: np.ndarray
    reader: TextReader

    @property
    def ids(self) -> np.ndarray:
        """Return the index of the proposal of each pixel, int32 [H, W]; 0 for none."""
        return self._view.ids

    def query_all(self, texts: Sequence[str], **rules: Any) -> list[QueryResult]:
        """See :class:`slgaussian.benchmark.answering.AnsweringView`."""
        return self._view.query_all(texts, **rules)

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """See :class:`slgaussian.benchmark.answering.AnsweringView`."""
        return self._view.segment(texts, **rules)

    @cached_property
    def _view(self) -> FieldView:
        inputs, with_depth = self.scene.inputs, self.scene.with_depth
        alpha, depth = self.picture.alpha, self.depth
        visible = alpha >= MIN_WEIGHT
        view = SeenView(View("rendered", self.camera, self.rgb), depth if with_depth else None)
        proposals = inputs.proposer.propose(view, None if visible.all() else visible)
        ids = np.where(visible, flatten(proposals), 0).astype(np.int32)
        label_maps = LabelMaps(ids[None], np.ones((1, *ids.shape), np.float32))
        local = inputs.gaussians.localize(self.camera)  # as the room
        surroundings = [inputs.geometry.room.place(local, depth)] if with_depth else None
        bank = inputs.look_at([view], label_maps, surroundings, with_depth)
        confidence = (ids > 0).astype(np.float32)
        return FieldView(
            self.rgb, ids, confidence, alpha, depth, inputs.field.with_changes(bank=bank)
        )
