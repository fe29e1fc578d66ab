"""Ablation: the paper's zero vector for a view that does not hold an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from slgaussian.benchmark.methods.inputs import Inputs
from slgaussian.field import FieldView, SemanticField
from slgaussian.language.query import QueryResult
from slgaussian.scene import Camera


@dataclass(frozen=True)
class AbsentZero:
    """The field, asked by the rule that an absent view scores 0.5 on everything."""

    def __call__(self, inputs: Inputs) -> _ZeroField:
        """See :class:`slgaussian.benchmark.methods.Method`."""
        return _ZeroField(inputs.field)


@dataclass(frozen=True, eq=False)
class _ZeroField:
    field: SemanticField

    def render(self, camera: Camera) -> _ZeroView:
        view = self.field.render(camera)
        return _ZeroView(**{each.name: getattr(view, each.name) for each in fields(view)})


class _ZeroView(FieldView):
    def query_all(self, texts: Sequence[str], **rules: Any) -> list[QueryResult]:
        return super().query_all(texts, **{**rules, "absent": "zero"})

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        return super().segment(texts, **{**rules, "absent": "zero"})
