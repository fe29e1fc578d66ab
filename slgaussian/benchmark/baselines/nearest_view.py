"""No 3D at all: the nearest photograph, with its own masks and what it says about them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slgaussian.benchmark.baselines.inputs import Inputs
from slgaussian.field import FieldView
from slgaussian.scene import Camera


@dataclass(frozen=True)
class NearestView:
    """Answers in the context view whose camera is nearest, whatever the camera asked for sees.

    Masks and features are those of the field, so that all it lacks is the rendering.
    """

    def __call__(self, inputs: Inputs) -> _Photographs:
        """See :class:`slgaussian.benchmark.baselines.Method`."""
        return _Photographs(inputs)


@dataclass(frozen=True, eq=False)
class _Photographs:
    inputs: Inputs

    def render(self, camera: Camera) -> FieldView:
        """The photograph taken nearest to ``camera``, of two as near the first.

        Brought to the camera's size as :meth:`slgaussian.scene.View.resized` does; there is no
        depth, for none belongs to this camera.
        """
        context = self.inputs.sample.context
        away = [np.linalg.norm(view.camera.center - camera.center) for view in context]
        index = int(np.argmin(away))
        own = self.inputs.label_maps.labels[index]
        labelled = replace(context[index], depth=None, instances=own)
        labelled = labelled.resized(camera.height, camera.width)
        bank = self.inputs.bank
        only = np.s_[:, index : index + 1]
        said = replace(
            bank,
            features=bank.features[only],
            present=bank.present[only],
            group_features=None if bank.group_features is None else bank.group_features[only],
            boxes=None,
        )
        ids = labelled.instances
        assert ids is not None  # they were given above
        return FieldView(
            labelled.image,
            ids,
            (ids > 0).astype(np.float32),
            np.ones(ids.shape, np.float32),
            np.zeros(ids.shape, np.float32),
            self.inputs.field.changed(bank=said),
        )
