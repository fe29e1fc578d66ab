"""Score one method against the ground truth of a scene, and render the pictures of the report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from dataclasses import field as dataclass_field
from typing import Any

import numpy as np

from slgaussian import system
from slgaussian.benchmark import metrics, pictures
from slgaussian.benchmark.annotations import Truth, boxes_of
from slgaussian.benchmark.answering import Answering, AnsweringView, Result, understands
from slgaussian.benchmark.protocols import (
    PROTOCOLS,
    Answer,
    Frame,
    Scored,
    ScoringProtocol,
    load_protocol,
)
from slgaussian.benchmark.scores import scene_means
from slgaussian.cameras.paths import between
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.io import short_repr
from slgaussian.kernels import compiling
from slgaussian.labels import LabelMaps
from slgaussian.language.rules import Rules
from slgaussian.scene import Sample, View
from slgaussian.storage.specs import load_spec

ALONG_THE_WAY = {"quarter way": 0.25, "halfway": 0.5, "three-quarter way": 0.75}
"""Rendered viewpoints between the first two context cameras, by frame name. Queries without ground
truth use the halfway view."""

ERROR_TOP = 0.2
"""Relative depth error that is shown as white."""

NOT_UNDERSTOOD = "not understood"
"""Note of a row whose query the method rejects: no known word, or an unusable text."""

ABSENT = "not in this frame"
"""Note of a row whose query has an empty true mask in the frame."""


@dataclass(frozen=True, eq=False)
class SceneResult:
    """All results of one scene and one method.

    Attributes:
        rows: list of dict. One per (frame, query, protocol), with the columns of the data spec
            ``samples``. A query without ground truth has one row, of the first protocol.
        scene_metrics: {name: float}. The scores of the first protocol
            (:func:`slgaussian.benchmark.scores.scene_means`), and ``psnr``, ``ssim`` (means over
            targets), ``abs_rel``, ``delta125`` (context views), ``bad2`` (the same, rectified pairs
            only), ``target_abs_rel``, ``target_delta125`` (rendered); metrics without ground truth
            are absent. ``near`` and ``far`` are the range of the depth colours.
        predictions: {(protocol, frame, query): bool [H, W]}. Mask of each row, with the row's
            protocol. Some protocols have no masks.
        pictures: {name: uint8 [H, W, 3]}. ``<kind>/<frame>`` or ``<kind>/<frame>/<query>``; kinds:
            ``input``, ``labels``, ``depth``, ``true_depth``, ``depth_error`` (context views),
            ``photo``, ``render``, ``ids`` (targets and viewpoints along the way), ``relevancy`` and
            ``mask`` (queries, by the first protocol).
        costs: list of dict. One per (frame, query), with those columns of the data spec ``times``
            that belong to the scene and method. Not reproducible.
    """

    scene: str
    rows: list[dict[str, Any]]
    scene_metrics: dict[str, float]
    predictions: dict[tuple[str, str, str], np.ndarray]
    pictures: dict[str, np.ndarray]
    dataset: str = "scenes"
    method: str = "slgaussian"
    costs: Sequence[Mapping[str, Any]] = ()

    __repr__ = short_repr


@dataclass(frozen=True)
class EvaluationSettings:
    """Settings of the evaluation of one method.

    Attributes:
        method: Name of the method in every row.
        dataset: Data set of the scene; scores of different data sets are not averaged.
        place: Name of the place, if several scenes show one place and are not independent samples.
        queries: sequence of str. Queries without ground truth, in the view midway between the first
            two context cameras.
        rules: Rules for answers.
        protocols: sequence of str. Names in :data:`slgaussian.benchmark.protocols.PROTOCOLS`.
            Pictures and scene metrics use the first. Default: all, that of ``rules`` first.
        drawn: Whether to render pictures.
    """

    method: str = "slgaussian"
    dataset: str = "scenes"
    place: str | None = None
    queries: Sequence[str] = ()
    rules: Rules = dataclass_field(default_factory=Rules)
    protocols: Sequence[str] = ()
    drawn: bool = True

    def load_protocols(self) -> list[ScoringProtocol]:
        """Return the protocols in their order.

        Raises:
            InputError: If a name is unknown.
        """
        return [load_protocol(name) for name in self.protocols or PROTOCOLS]


def truth_from_instances(sample: Sample) -> Truth:
    """Return masks by target view and phrase from the true instance ids.

    Instances with equal phrases are united; instances without a pixel in a view are omitted.
    """
    truth: dict[str, dict[str, np.ndarray]] = {}
    for view in sample.targets:
        masks = truth.setdefault(view.name, {})
        if view.instances is None:
            continue
        for instance, phrase in sample.phrases.items():
            mask = view.instances == instance
            if mask.any():
                masks[phrase] = masks.get(phrase, mask) | mask
    return Truth(masks=truth)


def evaluate(
    field: Answering,
    sample: Sample,
    label_maps: LabelMaps,
    truth: Truth,
    settings: EvaluationSettings | None = None,
    *,
    gaussians: Gaussians | None = None,
) -> SceneResult:
    """Query a method with all labelled texts in every target view, and score its answers.

    Each query is answered once for all protocols.

    Args:
        field: A field of ``sample``, or the scene of another method.
        sample: Its targets have the photographs for comparison.
        label_maps: Label maps of the context views, for the pictures.
        truth: An empty mask means that the frame has no ground truth for the query: it is queried
            and reported, not scored. Missing boxes are computed from the masks.
        settings: Further queries, and columns of the rows.
        gaussians: Gaussians of the context views' pixels, whose depths are scored and drawn.

    Returns:
        SceneResult: A query that is not understood has a row with score 0.

    Raises:
        InputError: If a frame of ``truth`` is not a target, a mask has another size than its view,
            a protocol is unknown, or a relevancy has another size, NaN, or values outside [0, 1].
    """
    _check_truth(sample, truth.masks)
    settings = settings or EvaluationSettings()
    queries, drawn = settings.queries, settings.drawn
    recorder = _Recorder(sample.scene, settings)
    texts = list(dict.fromkeys([*(t for of in truth.masks.values() for t in of), *queries]))
    if texts:
        recorder.warm_up(field.render(sample.context[0].camera), texts)
    for target in sample.targets:
        with recorder.timed():
            view = field.render(target.camera)
        masks, boxes = (of.get(target.name, {}) for of in (truth.masks, truth.boxes))
        recorder.ask(view, target.name, target.image, masks, boxes)
        recorder.measure("psnr", metrics.psnr(view.rgb, target.image))
        recorder.measure("ssim", metrics.ssim(view.rgb, target.image))
        if view.depth.any():
            recorder.measure_depth(view.depth, target, prefix="target_")
        if drawn:
            recorder.pictures[f"photo/{target.name}"] = target.image
            recorder.draw_view(view, target.name)

    first, second = (view.camera for view in sample.context[:2])
    for frame, step in ALONG_THE_WAY.items():
        if not drawn and not (queries and frame == "halfway"):
            continue
        camera = between(first, second, step)
        with recorder.timed():
            view = field.render(camera)
        if drawn:
            recorder.draw_view(view, frame)
        if frame == "halfway" and queries:
            nothing = np.zeros(view.rgb.shape[:2], bool)
            recorder.ask(
                view, frame, view.rgb, dict.fromkeys(queries, nothing), {}, has_truth=False
            )

    if gaussians is not None:
        recorder.look_at_depths(sample, gaussians)
    if not drawn:
        return recorder.result()
    for context, labels in zip(sample.context, label_maps.labels, strict=True):
        recorder.pictures[f"input/{context.name}"] = context.image
        recorder.pictures[f"labels/{context.name}"] = pictures.number_objects(labels, context.image)
    return recorder.result()


class _Recorder:
    """Collector of rows, pictures and costs of a scene."""

    def __init__(self, scene: str, settings: EvaluationSettings):
        rules, self.drawn = settings.rules, settings.drawn
        self._names = {"dataset": settings.dataset, "scene": scene, "method": settings.method}
        self.rules, self.query_rules = rules, dict(rules)
        self.protocols = settings.load_protocols()
        self.rows: list[dict[str, Any]] = []
        self.predictions: dict[tuple[str, str, str], np.ndarray] = {}
        self.pictures: dict[str, np.ndarray] = {}
        self.latest = 0.0
        self.costs: list[dict[str, Any]] = []
        self._measured: dict[str, list[float]] = {}
        self._constants: dict[str, float] = {}
        self._common = {
            **self._names,
            "place": settings.place,
            "temperature": rules.temperature,
            "canonical": "encoder's" if rules.phrases is None else ", ".join(rules.phrases),
            "absent": rules.absent,
        }

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Measure the seconds (``latest``) of the method inside the block."""
        start = compiling.clock()
        yield
        self.latest = compiling.clock() - start

    def measure(self, name: str, value: float) -> None:
        self._measured.setdefault(name, []).append(value)

    def measure_depth(
        self, depth: np.ndarray, view: View, scale: float | None = None, prefix: str = ""
    ) -> None:
        if view.depth is not None:
            for name, value in metrics.depth_errors(depth, view.depth, scale).items():
                self.measure(prefix + name, value)

    def look_at_depths(self, sample: Sample, gaussians: Gaussians) -> None:
        """Score and draw the predicted depths of the context views."""
        depths = source_depths(gaussians, [view.camera for view in sample.context])
        views = list(zip(sample.context, depths, strict=True))
        near, far = pictures.depth_range(*(d if v.depth is None else v.depth for v, d in views))
        self._constants |= {"near": near, "far": far}
        for view, depth in views:
            self.measure_depth(depth, view, _disparity_scale(sample))
            self.pictures |= _depth_pictures(view, depth, near, far)

    def ask(
        self,
        view: AnsweringView,
        frame: str,
        ground: np.ndarray,
        masks: Mapping[str, np.ndarray],
        boxes: Mapping[str, np.ndarray],
        has_truth: bool = True,
    ) -> None:
        """Answer, score and draw all queries of a frame, the keys of ``masks``.

        An empty mask means no ground truth in this frame; without ``has_truth`` there is none at
        all.
        """
        texts = [text for text in masks if understands(view.reader, text)]
        hits = self._query(view, frame, list(masks), texts)
        queried = Frame(
            [_answer(hits.get(text), mask, f"{frame!r}: {text!r}") for text, mask in masks.items()],
            list(masks.values()),
            [boxes_of(mask, boxes.get(text)) for text, mask in masks.items()],
            self._segment(view, texts, masks),
        )
        for protocol in self.protocols:
            mask_settings = protocol.mask_settings(self.rules, ground.shape[1])
            scored = protocol.score(queried, mask_settings)
            leads = protocol is self.protocols[0]
            for (text, mask), score in zip(masks.items(), scored, strict=True):
                if not leads and not mask.any():
                    continue
                names = {"frame": frame, "query": text, "protocol": protocol.label}
                names |= dict(zip(("height", "width"), mask.shape, strict=True))
                note = _note(hits.get(text), absent=has_truth and not mask.any())
                self._add_row(names | asdict(mask_settings), score, hits.get(text), note)
                if score.mask is not None:
                    self.predictions[protocol.label, frame, text] = score.mask
                if leads and self.drawn:
                    self._draw_query(f"{frame}/{text}", hits.get(text), score, mask, ground)

    def _query(
        self, view: AnsweringView, frame: str, queries: Sequence[str], texts: Sequence[str]
    ) -> dict[str, Result]:
        """Query the view with ``texts``, the understood ones of ``queries``, and time it."""
        seconds: dict[str, float | None] = {"view_seconds": None, "query_seconds": None}
        hits: Sequence[Result] = []
        if texts:
            rendered = self.latest
            with self.timed():
                self._answers(view, texts[:1])
            seconds["view_seconds"] = rendered + self.latest
            # Query it again with the others: answers must not depend on the timing.
            with self.timed():
                hits = self._answers(view, texts)
            seconds["query_seconds"] = self.latest / len(texts)
        for query in queries:
            row = {**self._names, "frame": frame, "query": query, **seconds}
            self.costs.append(row if query in texts else row | {"query_seconds": None})
        return dict(zip(texts, hits, strict=True))

    def warm_up(self, view: AnsweringView, texts: Sequence[str]) -> None:
        """Answer one of ``texts`` untimed: then all that is computed once per scene is cached."""
        for text in texts:
            if understands(view.reader, text):
                self._answers(view, [text])
                return

    def _answers(self, view: AnsweringView, texts: Sequence[str]) -> Sequence[Result]:
        hits = view.query_all(texts, **self.query_rules)
        for hit in hits:
            hit.mask, hit.relevancy, hit.point  # noqa: B018  (computed on first access)
        return hits

    def _segment(
        self, view: AnsweringView, texts: Sequence[str], masks: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Label pixels by queries of ``masks``, int32 [H, W]; only those in ``texts`` compete."""
        if not texts or not any(mask.any() for mask in masks.values()):
            return np.zeros(view.rgb.shape[:2], np.int32)
        competing = sorted(texts)
        with self.timed():
            # The protocols assign a class to every pixel, however low its score.
            rules = {**self.query_rules, "threshold": 0.0}
            labels = view.segment(competing, **rules)
        places = {text: k + 1 for k, text in enumerate(masks)}
        return np.array([0, *(places[text] for text in competing)], np.int32)[labels]

    def _add_row(
        self, row: Mapping[str, Any], scored: Scored, hit: Result | None, note: str
    ) -> None:
        x, y = (None, None) if scored.point is None else map(float, scored.point)
        score = None if hit is None else float(hit.score)
        rest = {"score": score, "point_x": x, "point_y": y, "note": note}
        columns = {**self._common, **row, **scored.scores, **rest}
        self.rows.append({name: columns.get(name) for name in load_spec("samples").columns})

    def draw_view(self, view: AnsweringView, frame: str) -> None:
        self.pictures[f"render/{frame}"] = view.rgb
        self.pictures[f"ids/{frame}"] = pictures.paint_labels(view.ids, view.rgb)

    def _draw_query(
        self, name: str, hit: Result | None, scored: Scored, mask: np.ndarray, ground: np.ndarray
    ) -> None:
        heat = np.zeros(mask.shape, np.float32) if hit is None else hit.relevancy
        predicted = np.zeros(mask.shape, bool) if scored.mask is None else scored.mask
        painted = pictures.paint_stretched(heat, ground)
        answer = pictures.spotlight(ground, predicted)
        answer = pictures.draw_outline(answer, predicted, pictures.PREDICTED)
        if mask.any():
            painted = pictures.draw_outline(painted, mask, pictures.TRUE)
            answer = pictures.draw_outline(answer, mask, pictures.TRUE)
        self.pictures[f"relevancy/{name}"] = pictures.draw_point(painted, scored.point)
        self.pictures[f"mask/{name}"] = pictures.draw_point(answer, scored.point)

    def result(self) -> SceneResult:
        leading = [row for row in self.rows if row["protocol"] == self.protocols[0].label]
        means = {name: float(np.mean(values)) for name, values in self._measured.items()}
        memory = {"peak_bytes": system.peak_memory()}
        return SceneResult(
            **self._names,
            rows=self.rows,
            scene_metrics=scene_means(leading) | means | self._constants,
            predictions=self.predictions,
            pictures=self.pictures,
            costs=[row | memory for row in self.costs],
        )


def _depth_pictures(
    view: View, depth: np.ndarray, near: float, far: float
) -> dict[str, np.ndarray]:
    drawn = {f"depth/{view.name}": pictures.paint_depth(depth, near, far)}
    if view.depth is not None:
        is_known = view.depth > 0
        truth = np.where(is_known, view.depth, 1).astype(np.float64)
        drawn[f"true_depth/{view.name}"] = pictures.paint_depth(view.depth, near, far)
        drawn[f"depth_error/{view.name}"] = pictures.paint_error(
            np.abs(depth - truth) / truth, is_known, ERROR_TOP
        )
    return drawn


def _answer(hit: Result | None, truth: np.ndarray, where: str) -> Answer:
    """Return the answer for the protocols; an empty one if the text is not understood."""
    if hit is None:
        nothing = np.zeros(truth.shape, np.float32)
        return Answer(nothing, nothing.astype(bool), None)
    for name, array in (("relevancy", hit.relevancy), ("mask", hit.mask)):
        if array.shape != truth.shape:
            raise InputError(f"{where}: the {name} is {array.shape}, expected {truth.shape}")
    low, high = hit.relevancy.min(), hit.relevancy.max()
    if not (low >= 0 and high <= 1):
        raise InputError(
            f"{where}: relevancy goes from {low} to {high}, expected numbers from 0 to 1"
        )
    return Answer(hit.relevancy, hit.mask, hit.point)


def _note(hit: Result | None, absent: bool) -> str:
    notes = [] if hit is not None else [NOT_UNDERSTOOD]
    if hit is not None and hit.unknown:
        notes.append(f"unknown: {', '.join(hit.unknown)}")
    if absent:
        notes.append(ABSENT)
    return "; ".join(notes)


def _disparity_scale(sample: Sample) -> float | None:
    """Return focal length times baseline if the context is one rectified pair, for which disparity
    is defined; else None."""
    if len(sample.context) != 2:
        return None
    a, b = (view.camera for view in sample.context)
    shift = a.c2w[:3, :3].T @ (b.center - a.center)
    aligned = np.allclose(a.c2w[:3, :3], b.c2w[:3, :3], atol=1e-6) and a.K[0, 0] == b.K[0, 0]
    sideways = np.abs(shift[1:]).max() <= 1e-6 * np.abs(shift[0])
    return float(a.K[0, 0] * np.abs(shift[0])) if aligned and sideways else None


def _check_truth(sample: Sample, truth: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    sizes = {view.name: view.image.shape[:2] for view in sample.targets}
    for frame, masks in truth.items():
        if frame not in sizes:
            raise InputError(
                f"scene {sample.scene!r}: truth is given for {frame!r}, which is not a target view "
                f"(targets: {', '.join(sizes) or 'none'})"
            )
        for query, mask in masks.items():
            if mask.dtype != bool or mask.shape != sizes[frame]:
                raise InputError(
                    f"scene {sample.scene!r}: the true mask of {query!r} in {frame!r} is "
                    f"{mask.dtype} {mask.shape}, expected bool {sizes[frame]}"
                )
