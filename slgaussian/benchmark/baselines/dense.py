"""Rendering and answers of methods with one vector per pixel and without objects.

The rules of objects (:class:`slgaussian.language.rules.Rules`) are applied to pixels. The gap of a
pixel is its cosine with the text minus its cosine with the best canonical phrase:

- ``near-best``: pixels with a gap above 0 and at least a fraction of the best gap. The best gap is
  a quantile (:data:`BEST_FRACTION`), because single pixels on borders determine the maximum.
- ``threshold``: pixels whose relevancy is above it.

The point is the maximum of the relevancy after LangSplat's smoothing, with a filter scaled to the
image; on a plateau the pixel farthest from its edge
(:func:`slgaussian.language.objectmap.central_point`). The rule for absent views does not apply,
because views are mixed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.special import expit, logit

from slgaussian.field_view import mean_colour
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.language import langsplat
from slgaussian.language.objectmap import central_point
from slgaussian.language.rules import Rules
from slgaussian.language.scoring import TextReader
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera

BEST_FRACTION = 0.01
"""Fraction of the pixels that reach the best gap. LangSplat-like has IoU 0.345 on the office set
with it, 0.26 with the largest gap, and 0.337 with the gap at the point."""


class Picture(NamedTuple):
    """A rendered image: rgb uint8 [H, W, 3], alpha float32 [H, W], and z-depth float32 [H, W] in
    scene units, 0 where empty."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray


def draw_picture(gaussians: Gaussians, camera: Camera) -> Picture:
    """Render the colours of the Gaussians for ``camera``."""
    image = rasterize(gaussians, None, camera)
    alpha = image.alpha.float().numpy()
    return Picture(
        mean_colour(image.values.float().numpy(), alpha), alpha, image.depth.float().numpy()
    )


@dataclass(frozen=True, eq=False)
class DenseView:
    """A view with vectors per pixel.

    Attributes:
        rgb: uint8 [H, W, 3]
        depth: float32 [H, W]
        seen: bool [H, W]. Whether the pixel is known.
        vectors: float32 [h, w, C]. Vectors, of which only the directions are used; at the size of
            the view or smaller.
    """

    rgb: np.ndarray
    depth: np.ndarray
    reader: TextReader
    seen: np.ndarray
    vectors: np.ndarray

    @property
    def ids(self) -> np.ndarray:
        """Return zeros, int32 [H, W]: there are no objects."""
        return np.zeros(self.seen.shape, np.int32)

    def query_all(self, texts: Sequence[str], **rules: Any) -> list[DenseResult]:
        """See :class:`slgaussian.benchmark.answering.AnsweringView`."""
        query_rules, reader = Rules(**rules), self.reader
        return [
            DenseResult(text, reader.unknown_words(text), gap, self.seen, query_rules)
            for text, gap in zip(texts, self.gaps(texts, query_rules), strict=True)
        ]

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """See :class:`slgaussian.benchmark.answering.AnsweringView`; ties go to the first text."""
        winner = np.argmax(self.gaps(texts, Rules(**rules)), 0) + 1
        return np.where(self.seen, winner, 0).astype(np.int32)

    def gaps(self, texts: Sequence[str], rules: Rules) -> list[np.ndarray]:
        """Compute the margins in cosine over the best canonical phrase, float64 [H, W] per text.

        Raises InputError if the encoder cannot use a text.
        """
        size, full_size = self.vectors.shape[:2], self.seen.shape[::-1]
        rival = self._cosines(self.reader.phrases(rules)).max(0)
        return [
            cv2.resize(gap.reshape(size), full_size, interpolation=cv2.INTER_LINEAR)
            for gap in self._cosines(texts) - rival
        ]

    def _cosines(self, texts: Sequence[str]) -> np.ndarray:
        """Compute the cosines with texts, float64 [Q, h * w]."""
        queries = self.reader.vectors(texts).astype(np.float64)
        queries /= np.linalg.norm(queries, axis=1, keepdims=True)
        flat = self.vectors.reshape(-1, self.vectors.shape[2])
        similarity = np.empty((len(queries), len(flat)))
        share(cosines, len(flat), flat, queries, similarity)
        return similarity


@dataclass(frozen=True, eq=False)
class DenseResult:
    """Answer to a text; see :class:`slgaussian.benchmark.answering.Result`.

    Attributes:
        gap: float64 [H, W]
        seen: bool [H, W]
    """

    text: str
    unknown: tuple[str, ...]
    gap: np.ndarray
    seen: np.ndarray
    rules: Rules

    @property
    def score(self) -> float:
        """Return the largest relevancy; 0 if no pixel is known."""
        return float(self._dense_relevancy[self.seen].max(initial=0.0))

    @cached_property
    def relevancy(self) -> np.ndarray:
        """Return the relevancy, float32 [H, W] in [0, 1]; 0 where unknown."""
        return np.where(self.seen, self._dense_relevancy, 0).astype(np.float32)

    @cached_property
    def mask(self) -> np.ndarray:
        """Return the pixels that the rules select, bool [H, W]."""
        if self.rules.selection == "threshold":
            return self.seen & (self.gap > logit(self.rules.threshold) / self.rules.temperature)
        fits = self.seen & (self.gap > 0)
        if not fits.any():
            return fits
        best = np.quantile(self.gap[self.seen], 1 - BEST_FRACTION)
        return fits & (self.gap >= self.rules.share * best)

    @cached_property
    def point(self) -> tuple[int, int] | None:
        """Return column and row (x, y) of the predicted location; see the module."""
        if not self.seen.any():
            return None
        side = langsplat.rescaled_filter(self.seen.shape[1])
        smooth = np.where(self.seen, langsplat.smooth(self._dense_relevancy, side), -1)
        return central_point(smooth == smooth.max())

    @cached_property
    def _dense_relevancy(self) -> np.ndarray:
        """Return the relevancy float64 [H, W], with the minimum at unknown pixels, so that holes do
        not stretch the range."""
        relevancy = expit(self.rules.temperature * self.gap)
        return np.where(self.seen, relevancy, relevancy[self.seen].min(initial=1.0))


@kernel
def cosines(
    counter: np.ndarray, vectors: np.ndarray, texts: np.ndarray, similarity: np.ndarray
) -> None:
    """Compute the cosines [Q, P] of vectors float32 [P, C] with unit texts float64 [Q, C].

    Zero vectors give 0. The order of summation does not depend on the number of threads.
    """
    p = take(counter)
    while p < len(vectors):
        vector = vectors[p]
        squared = 0.0
        for c in range(vectors.shape[1]):
            squared += np.float64(vector[c]) * np.float64(vector[c])
        scale = 1 / np.sqrt(squared) if squared > 0 else 0.0
        for q in range(len(texts)):
            total = 0.0
            for c in range(vectors.shape[1]):
                total += np.float64(vector[c]) * texts[q, c]
            similarity[q, p] = total * scale
        p = take(counter)
