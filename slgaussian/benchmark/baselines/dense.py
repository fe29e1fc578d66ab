"""Rendering and answers of methods with one vector per pixel and without objects.

The rules of objects (:class:`slgaussian.language.rules.Rules`) are applied to pixels. The gap of a
pixel is its cosine with the text minus its cosine with the best rival:

- ``near-best``: pixels with a gap above 0 and at least a fraction of the best gap. The best gap is
  a quantile (:data:`BEST_FRACTION`), because single pixels on borders determine the maximum.
- ``threshold``: pixels whose relevancy is above it.

The point is the maximum of the relevancy after LangSplat's smoothing, with a filter scaled to the
image; on a plateau the pixel farthest from its edge
(:func:`slgaussian.language.objectmap.central_point`). Of several scales, a text uses the one with
its largest gap for the whole image, as LERF does. The rule for absent views does not apply, because
views are mixed here. LangSplat's own mask and point are computed by its protocol
(:mod:`slgaussian.benchmark.protocols`) from the relevancy of any method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from scipy.special import expit, logit

from slgaussian.field import shown
from slgaussian.formats.resampling import Window
from slgaussian.gaussians import Gaussians
from slgaussian.kernels.jit import kernel
from slgaussian.kernels.work_sharing import share, take
from slgaussian.language import langsplat
from slgaussian.language.objectmap import central_point
from slgaussian.language.reader import TextReader
from slgaussian.language.rules import Rules
from slgaussian.rasterize import rasterize
from slgaussian.scene import Camera

BEST_FRACTION = 0.01
"""Fraction of the pixels that reach the best gap. On the office set and procedural rooms each
method has a higher IoU with it than with the largest gap, or the gap at the point: LangSplat-like
0.345 on office against 0.26 and 0.337, LERF-like 0.287 against 0.228 and 0.25."""

TOGETHER = 64
"""Feature dimensions rendered in one pass: 490,000 Gaussians then take 125 MB of memory."""

MOST_NUMBERS = 2**26
"""Largest number of elements of a feature image, 256 MB in float32; a larger one is rendered at a
half, a quarter ... of the resolution. At 416 x 576, vectors of 58 dimensions at three scales fit;
those of 512 at one scale are rendered at half resolution."""


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
    return Picture(shown(image.values.float().numpy(), alpha), alpha, image.depth.float().numpy())


def draw_vectors(
    gaussians: Gaussians,
    camera: Camera,
    scales: Sequence[Callable[[np.ndarray, int, int], np.ndarray]],
    width: int,
) -> np.ndarray:
    """Composite the vectors of the Gaussians' source pixels with their blending weights.

    Each of ``scales`` is a function ``at(pixels, start, stop)`` that returns features ``start`` to
    ``stop`` of ``width`` of the given pixels, float32 [n, stop - start], so that not all are in
    memory at once; pixels int64 [n] are flat indices of [V, H, W]. Returns [S, H, W, width].
    """
    source = gaussians.source.numpy()
    images = np.empty((len(scales), camera.height, camera.width, width), np.float32)
    for at, image in zip(scales, images, strict=True):
        for start in range(0, width, TOGETHER):
            stop = min(start + TOGETHER, width)
            values = torch.from_numpy(at(source, start, stop))
            image[..., start:stop] = rasterize(gaussians, values, camera).values.float().numpy()
    return images


def reduced(camera: Camera, numbers: int) -> Camera:
    """Return the camera at full, half, a quarter ... of the resolution, the first at which
    ``numbers`` per pixel do not exceed :data:`MOST_NUMBERS`."""
    factor = 1
    while camera.height * camera.width * numbers > MOST_NUMBERS * factor**2:
        factor *= 2
    return camera.resized(max(camera.width // factor, 1), max(camera.height // factor, 1))


@dataclass(frozen=True, eq=False)
class DenseView:
    """A view with vectors per pixel.

    Attributes:
        rgb: uint8 [H, W, 3]
        depth: float32 [H, W]
        seen: bool [H, W]. Whether the pixel is known.
        vectors: float32 [S, h, w, C]. Vectors at S scales, of which only the directions are used;
            at the size of the view or smaller.
        classes: tuple of str. Closed list: texts compete with these instead of canonical phrases,
            and the near-best rule selects all pixels at which a text wins.
    """

    rgb: np.ndarray
    depth: np.ndarray
    reader: TextReader
    seen: np.ndarray
    vectors: np.ndarray
    classes: tuple[str, ...] = ()

    @cached_property
    def ids(self) -> np.ndarray:
        """Return zeros, int32 [H, W]: there are no objects."""
        return np.zeros(self.seen.shape, np.int32)

    def query_all(self, texts: Sequence[str], **rules: Any) -> list[DenseResult]:
        """See :class:`slgaussian.benchmark.answering.AnsweringView`."""
        query_rules, reader = Rules(**rules), self.reader
        reader.vectors(texts)  # raises before expensive work
        return [
            DenseResult(
                text,
                reader.unknown_words(text),
                self.gap(text, query_rules),
                self.seen,
                query_rules,
                bool(self.classes),
            )
            for text in texts
        ]

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """See :class:`slgaussian.benchmark.answering.AnsweringView`; ties go to the first text."""
        query_rules = Rules(**rules)
        self.reader.vectors(texts)
        best, winner = np.full(self.seen.shape, -np.inf), np.zeros(self.seen.shape, np.int32)
        for number, text in enumerate(texts, start=1):
            gap = self.gap(text, query_rules)
            better = gap > best
            best[better], winner[better] = gap[better], number
        return np.where(self.seen, winner, 0).astype(np.int32)

    def gap(self, text: str, rules: Rules) -> np.ndarray:
        """Compute the margin in cosine over the best rival, float64 [H, W], at the text's scale.

        Raises InputError if the encoder cannot use the text.
        """
        size = self.vectors.shape[1:3]
        gaps = self._cosines((text,))[0] - self._rival(text, rules)
        full_size = self.seen.shape[::-1]
        visible = Window.whole(*full_size).mask(self.seen, *size)
        best = gaps.max(1, where=visible.ravel(), initial=-np.inf).argmax()
        return cv2.resize(gaps[best].reshape(size), full_size, interpolation=cv2.INTER_LINEAR)

    def _rival(self, text: str, rules: Rules) -> np.ndarray:
        """Return the cosine with the best rival of a text, float64 [S, h * w]."""
        rival_places = [k for k, name in enumerate(self.classes) if name != text]
        rivals = self.classes if rival_places else self.reader.phrases(rules)
        cache = self._cosines_of_rivals
        if rivals not in cache:
            cache[rivals] = self._cosines(rivals)
        return cache[rivals][rival_places or slice(None)].max(0)

    @cached_property
    def _cosines_of_rivals(self) -> dict[tuple[str, ...], np.ndarray]:
        """Cache of the cosines with rival texts."""
        return {}

    def _cosines(self, texts: Sequence[str]) -> np.ndarray:
        """Compute the cosines with texts, float64 [Q, S, h * w]."""
        scales, h, w, width = self.vectors.shape
        queries = self.reader.vectors(texts).astype(np.float64)
        queries /= np.linalg.norm(queries, axis=1, keepdims=True)
        flat = self.vectors.reshape(-1, width)
        similarity = np.empty((len(queries), len(flat)))
        share(cosines, len(flat), flat, queries, similarity)
        return similarity.reshape(len(queries), scales, h * w)


@dataclass(frozen=True, eq=False)
class DenseResult:
    """Answer to a text; see :class:`slgaussian.benchmark.answering.Result`.

    Attributes:
        gap: float64 [H, W]
        seen: bool [H, W]
        closed: Whether texts compete with a closed list.
    """

    text: str
    unknown: tuple[str, ...]
    gap: np.ndarray
    seen: np.ndarray
    rules: Rules
    closed: bool = False

    @cached_property
    def score(self) -> float:
        """Return the largest relevancy; 0 if no pixel is known."""
        return float(self._filled[self.seen].max(initial=0.0))

    @cached_property
    def relevancy(self) -> np.ndarray:
        """Return the relevancy, float32 [H, W] in [0, 1]; 0 where unknown."""
        return np.where(self.seen, self._filled, 0).astype(np.float32)

    @cached_property
    def mask(self) -> np.ndarray:
        """Return the pixels that the rules select, bool [H, W]."""
        if self.rules.selection == "threshold":
            return self.seen & (self.gap > logit(self.rules.threshold) / self.rules.temperature)
        fits = self.seen & (self.gap > 0)
        if self.closed or not fits.any():
            return fits
        best = np.quantile(self.gap[self.seen], 1 - BEST_FRACTION)
        return fits & (self.gap >= self.rules.share * best)

    @cached_property
    def point(self) -> tuple[int, int] | None:
        """Return column and row (x, y) of the predicted location; see the module."""
        if not self.seen.any():
            return None
        side = langsplat.rescaled_filter(self.seen.shape[1])
        smooth = np.where(self.seen, langsplat.smoothed(self._filled, side), -1)
        return central_point(smooth == smooth.max())

    @cached_property
    def _filled(self) -> np.ndarray:
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
