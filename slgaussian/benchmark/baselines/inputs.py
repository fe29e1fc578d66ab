"""Inputs of a method of one scene, and what several methods need of them."""

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
from slgaussian.language.reader import TextReader
from slgaussian.masks import MaskProposer
from slgaussian.masks.flatten import flatten, without_crumbs
from slgaussian.masks.levels import group_objects
from slgaussian.scene import Sample


@dataclass(frozen=True, eq=False)
class Inputs:
    """A scene with the field of the default method; methods look at no target and no truth.

    Attributes
    ----------
    sample : Sample
    field : SemanticField
        What :func:`slgaussian.build.build_field` made of it.
    gaussians : Gaussians
        As predicted, without features: the field may have merged some.
    label_maps : LabelMaps
        Of the context views, as they went into the field.
    proposer : MaskProposer
        The one that they were made with.
    seed : int
        Of the field too: decides codes and the weights of networks at their start.
    settings : {part: settings}
        Of the parts of the field, as :func:`slgaussian.build.build_field` takes them.
    classes : tuple of str
        All that will be asked of the scene, for methods that need a closed list.
    """

    sample: Sample
    field: SemanticField
    gaussians: Gaussians
    label_maps: LabelMaps
    proposer: MaskProposer
    seed: int = 0
    settings: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
    classes: tuple[str, ...] = ()

    @property
    def bank(self) -> MemoryBank:
        """Features of each object in the context views."""
        return self.field.bank

    @property
    def encoder(self) -> Encoder:
        """The encoder of regions and texts."""
        return self.field.encoder

    @cached_property
    def reader(self) -> TextReader:
        """Texts as vectors."""
        return TextReader(self.encoder)

    @cached_property
    def geometry(self) -> SceneGeometry:
        """The context views and their predicted depth."""
        return SceneGeometry.of(self.sample.context, self.gaussians)

    @cached_property
    def own_labels(self) -> LabelMaps:
        """Label maps of each context view on its own: no id is in two views."""
        maps, count = [], 0
        for view in self.geometry.frames:
            ids = without_crumbs(flatten(self.proposer.propose(view)))
            maps.append(np.where(ids > 0, ids + count, 0).astype(np.int32))
            count += int(ids.max(initial=0))
        labels = np.stack(maps)
        return LabelMaps(labels, np.ones(labels.shape, np.float32))

    @cached_property
    def own_bank(self) -> MemoryBank:
        """Features of :attr:`own_labels`, without codes and groups."""
        return self.look_at(self.geometry.frames, self.own_labels, self.geometry.surroundings)

    def look_at(
        self,
        views: Sequence[SeenView],
        label_maps: LabelMaps,
        surroundings: Sequence[Surroundings] | None,
        grouped: bool = False,
    ) -> MemoryBank:
        """Encode the objects of label maps of some views, without codes.

        If ``grouped``, groups of objects too where the field has those. Without any object the bank
        is empty.
        """
        ids, groups, wholes = label_maps.ids, None, None
        codes = np.zeros((len(ids), 0), np.float32)
        if len(ids) == 0:
            nothing = np.zeros((0, len(views), self.bank.features.shape[2]), np.float32)
            return MemoryBank(ids, codes, nothing, np.zeros((0, len(views)), bool))
        if grouped and self.bank.levels is not None:
            groups, wholes = group_objects(views, label_maps)
        images = [view.view for view in views]
        return build_bank(images, label_maps, self.encoder, codes, surroundings, groups, wholes)
