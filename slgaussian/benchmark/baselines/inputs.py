"""Inputs of a method for one scene, and quantities that several methods derive from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.geometry.room import Surroundings
from slgaussian.labels import LabelMaps
from slgaussian.language import Encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.scoring import TextReader
from slgaussian.masks import MaskProposer
from slgaussian.masks.flatten import flatten, remove_crumbs
from slgaussian.masks.levels import group_objects
from slgaussian.scene import Sample, opaque_pixels


@dataclass(frozen=True, eq=False)
class Inputs:
    """A scene with the field of the default method; methods must not use targets or ground truth.

    Attributes:
        field: Result of :func:`slgaussian.build.build_field`.
        gaussians: Predicted Gaussians without features, before merging.
        label_maps: Label maps of the context views from which the field was built.
        proposer: Proposer of these label maps.
        seed: Seed of the field, for codes and initial network weights.
        settings: Settings of the field's components by their names.
    """

    sample: Sample
    field: SemanticField
    gaussians: Gaussians
    label_maps: LabelMaps
    proposer: MaskProposer
    seed: int = 0
    settings: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)

    @property
    def bank(self) -> MemoryBank:
        """Memory bank of the field: features of each object in the context views."""
        return self.field.bank

    @property
    def encoder(self) -> Encoder:
        """Encoder of regions and texts."""
        return self.field.encoder

    @cached_property
    def reader(self) -> TextReader:
        """Encoder of texts."""
        return TextReader(self.encoder)

    @cached_property
    def geometry(self) -> SceneGeometry:
        """Context views with their predicted depth."""
        return SceneGeometry.of(self.sample.context, self.gaussians)

    @cached_property
    def own_labels(self) -> LabelMaps:
        """Label maps without association: no id occurs in two context views."""
        maps, count = [], 0
        for view in self.geometry.frames:
            ids = remove_crumbs(flatten(self.proposer.propose(view)))
            maps.append(np.where(ids > 0, ids + count, 0).astype(np.int32))
            count += int(ids.max(initial=0))
        labels, opaque = np.stack(maps), opaque_pixels(self.sample.context)
        labels = labels if opaque is None else np.where(opaque, labels, 0)
        return LabelMaps(labels, np.ones(labels.shape, np.float32))

    @cached_property
    def own_bank(self) -> MemoryBank:
        """Memory bank of :attr:`own_labels`, with arbitrary codes and no groups."""
        return self.look_at(self.geometry.frames, self.own_labels, self.geometry.surroundings)

    def look_at(
        self,
        views: Sequence[SeenView],
        label_maps: LabelMaps,
        surroundings: Sequence[Surroundings] | None,
        grouped: bool = False,
    ) -> MemoryBank:
        """Encode the objects of label maps of some views, with arbitrary codes.

        With ``grouped`` also groups of objects, if the field has groups.
        """
        ids, groups, wholes = label_maps.ids, None, None
        codes = np.linspace([0, 0, 0], [1, 1, 1], len(ids), dtype=np.float32)  # any that differ
        if len(ids) == 0:
            nothing = np.zeros((0, len(views), self.bank.features.shape[2]), np.float32)
            return MemoryBank(ids, codes, nothing, np.zeros((0, len(views)), bool))
        if grouped and self.bank.levels is not None:
            groups, wholes = group_objects(views, label_maps)
        images = [view.view for view in views]
        return build_bank(images, label_maps, self.encoder, codes, surroundings, groups, wholes)
