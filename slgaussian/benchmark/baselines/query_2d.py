"""The paper's 2D query (Table 4): the novel view as a picture, cut up and encoded there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slgaussian.benchmark.baselines.drawn import Picture, draw_picture
from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.field import FieldView
from slgaussian.geometry import SeenView
from slgaussian.labels import LabelMaps
from slgaussian.language.query import QueryResult, TextReader
from slgaussian.masks.flatten import flatten
from slgaussian.scene import Camera, View
from slgaussian.semantic.decode import VISIBLE


@dataclass(frozen=True)
class Query2d:
    """Renders colours, then works on the picture as on a photograph.

    Nothing is prepared: proposals and encoding belong to the first query of a view, as in the
    paper's 18 s a query. Where the picture is empty nothing is proposed.

    Attributes
    ----------
    depth : bool
        Whether the picture is looked at as the field looks at photographs: with its depth, for
        masks and words, and in groups of objects too. The paper's proposer and encoder see the
        picture alone.
    """

    depth: bool = False

    def __call__(self, inputs: Inputs) -> _Pictures:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        image = inputs.sample.context[0].image
        # One that does not look at images says so now, and not at the first query.
        inputs.encoder.encode_regions(image, np.zeros((0, *image.shape[:2]), bool))
        return _Pictures(inputs, self.depth)


@dataclass(frozen=True, eq=False)
class _Pictures:
    inputs: Inputs
    with_depth: bool

    def render(self, camera: Camera) -> _PictureView:
        picture = draw_picture(self.inputs.gaussians, camera)
        return _PictureView(picture, camera, self.inputs, self.with_depth)


@dataclass(frozen=True, eq=False)
class _PictureView:
    picture: Picture
    camera: Camera
    inputs: Inputs
    with_depth: bool

    @property
    def rgb(self) -> np.ndarray:
        return self.picture.rgb

    @property
    def depth(self) -> np.ndarray:
        return self.picture.depth

    @property
    def reader(self) -> TextReader:
        return self.inputs.reader

    @property
    def ids(self) -> np.ndarray:
        return self._cut_up.ids

    def query_all(self, texts: Sequence[str], **rules: Any) -> list[QueryResult]:
        return self._cut_up.query_all(texts, **rules)

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        return self._cut_up.segment(texts, **rules)

    @cached_property
    def _cut_up(self) -> FieldView:
        """Proposals and what the encoder says of them, in one go."""
        rgb, depth, alpha = self.picture.rgb, self.picture.depth, self.picture.alpha
        there = alpha >= VISIBLE
        where = None if there.all() else there
        seen = SeenView(View("rendered", self.camera, rgb), depth if self.with_depth else None)
        proposals = self.inputs.proposer.propose(seen, where)
        ids = np.where(there, flatten(proposals), 0).astype(np.int32)
        label_maps = LabelMaps(ids[None], np.ones((1, *ids.shape), np.float32))
        room = self.inputs.geometry.room
        around = [room.place(self.camera, depth)] if self.with_depth else None
        bank = self.inputs.look_at([seen], label_maps, around, self.with_depth)
        sure = (ids > 0).astype(np.float32)
        return FieldView(rgb, ids, sure, alpha, depth, self.inputs.field.changed(bank=bank))
