"""Score one method against the ground truth of a scene, and render the pictures of the report."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from dataclasses import field as dataclass_field
from typing import Any

import numpy as np

from slgaussian import system
from slgaussian.benchmark import metrics, pictures
from slgaussian.benchmark.annotations import Truth, find_boxes
from slgaussian.benchmark.answering import Answering, AnsweringView, Result, keep_understood
from slgaussian.benchmark.protocols import (
    PROTOCOLS,
    Answer,
    Frame,
    MaskSettings,
    Scored,
    ScoringProtocol,
    load_protocol,
)
from slgaussian.benchmark.scores import scene_means
from slgaussian.cameras.paths import between
from slgaussian.errors import InputError
from slgaussian.gaussians import Gaussians
from slgaussian.geometry.seen import view_depths
from slgaussian.io import short_repr
from slgaussian.kernels import compiling
from slgaussian.labels import LabelMaps
from slgaussian.language.rules import Rules
from slgaussian.scene import Sample
from slgaussian.storage.specs import load_spec

RENDERED_VIEWPOINTS = {"quarter way": 0.25, "halfway": 0.5, "three-quarter way": 0.75}
"""Rendered viewpoints between the first two context cameras, by frame name. Queries without ground
truth use the halfway view."""

NOT_UNDERSTOOD = "not understood"
"""Note of a row whose query the method rejects: no known word, or an unusable text."""

ABSENT = "not in this frame"
"""Note of a row whose query has an empty true mask in the frame."""


@dataclass(frozen=True, eq=False)
class SceneResult:
    """All results of one scene and one method.

    Attributes:
        rows: One per (frame, query, protocol), with the columns of the data spec ``samples``. A
            query without ground truth has one row, of the first protocol.
        scene_metrics: The scores of the first protocol
            (:func:`slgaussian.benchmark.scores.scene_means`), and ``psnr``, ``ssim`` (means over
            targets), ``abs_rel``, ``delta125`` (context views), ``bad2`` (the same, rectified pairs
            only), ``target_abs_rel``, ``target_delta125`` (rendered); metrics without ground truth
            are absent. ``near`` and ``far`` are the range of the depth colours.
        predictions: Mask bool [H, W] by protocol, frame and query; some protocols have none.
        pictures: uint8 [H, W, 3] by ``<kind>/<frame>`` or ``<kind>/<frame>/<query>``; kinds:
            ``input``, ``labels``, ``depth``, ``true_depth`` (context views), ``photo``, ``render``,
            ``ids`` (targets and viewpoints along the way), ``relevancy`` and ``mask`` (queries, by
            the first protocol).
        costs: One per (frame, query), with those columns of the data spec ``times`` that belong to
            the scene and method. Not reproducible.
    """

    scene: str
    rows: Sequence[Mapping[str, Any]]
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
        queries: Queries without ground truth, in the view midway between the first two context
            cameras.
        protocols: Names in :data:`slgaussian.benchmark.protocols.PROTOCOLS`; by default all.
            Pictures and scene metrics use the first.
        drawn: Whether to render pictures.
    """

    method: str = "slgaussian"
    dataset: str = "scenes"
    place: str | None = None
    queries: Sequence[str] = ()
    rules: Rules = dataclass_field(default_factory=Rules)
    protocols: Sequence[str] = ()
    drawn: bool = True


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
    return Truth(truth, opaque={v.name: v.opaque for v in sample.targets if v.opaque is not None})


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

    Args:
        field: A field of ``sample``, or the scene of another method.
        sample: Its targets have the photographs for comparison.
        label_maps: Label maps of the context views, for the pictures.
        truth: An empty mask means that the frame has no ground truth for the query: it is queried
            and reported, not scored. Missing boxes are computed from the masks.
        settings: Further queries, and columns of the rows.
        gaussians: Gaussians of the context views' pixels, whose depths are scored and drawn.

    Raises:
        InputError: If a protocol is unknown, or a relevancy has another size than its view, NaN, or
            values outside [0, 1].
    """
    settings = settings or EvaluationSettings()
    queries, drawn = settings.queries, settings.drawn
    recorder = _Recorder(sample.scene, settings)
    if texts := [*(text for masks in truth.masks.values() for text in masks), *queries]:
        # Answer a text untimed: then all that is computed once per scene is cached.
        view = field.render(sample.context[0].camera)
        if understood := keep_understood(view.reader, dict.fromkeys(texts)):
            recorder.query(view, understood[:1])
    for target in sample.targets:
        view, seconds = _measure_time(field.render, target.camera)
        masks, boxes = (of.get(target.name, {}) for of in (truth.masks, truth.boxes))
        recorder.ask(view, seconds, target.name, target.image, masks, boxes, opaque=target.opaque)
        if target.opaque is None or target.opaque.any():
            images = view.rgb, target.image, target.opaque
            recorder.measure({"psnr": metrics.psnr(*images), "ssim": metrics.ssim(*images)})
        if view.depth.any() and target.depth is not None:
            errors = metrics.depth_errors(view.depth, target.depth)
            recorder.measure({f"target_{name}": value for name, value in errors.items()})
        if drawn:
            recorder.pictures[f"photo/{target.name}"] = target.image
            recorder.draw_view(view, target.name)
    first, second = (view.camera for view in sample.context[:2])
    for frame, step in RENDERED_VIEWPOINTS.items():
        is_queried = frame == "halfway" and bool(queries)
        if not drawn and not is_queried:
            continue
        view, seconds = _measure_time(field.render, between(first, second, step))
        if drawn:
            recorder.draw_view(view, frame)
        if is_queried:
            masks = dict.fromkeys(queries, np.zeros(view.rgb.shape[:2], bool))
            recorder.ask(view, seconds, frame, view.rgb, masks, {}, has_truth=False)
    if gaussians is not None:
        recorder.evaluate_depths(sample, gaussians)
    if drawn:
        for context, ids in zip(sample.context, label_maps.labels, strict=True):
            recorder.pictures[f"input/{context.name}"] = context.image
            labelled = pictures.number_objects(ids, context.image)
            recorder.pictures[f"labels/{context.name}"] = labelled
    return recorder.result()


def _measure_time(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Return the result of a call, and its seconds without compiling."""
    start = compiling.clock()
    returned = call(*arguments)
    return returned, compiling.clock() - start


def score_frame(
    frame: Frame,
    texts: Sequence[str],
    protocols: Sequence[ScoringProtocol],
    rules: Rules | None,
    common: Mapping[str, Any],
    columns: Mapping[str, Mapping[str, Any]],
) -> Iterator[tuple[dict[str, Any], Scored]]:
    """Score the answers of a frame; yield rows of the spec ``samples``, and what was scored.

    A text without ground truth in the frame has one row, of the first protocol. ``rules`` are None
    for external masks; ``common`` are the columns of all rows, ``columns`` those of a text's rows.
    """
    for protocol in protocols:
        mask_settings = MaskSettings("given")
        if rules is not None:
            mask_settings = protocol.mask_settings(rules, frame.masks[0].shape[1])
        for text, mask, scored in zip(
            texts, frame.masks, protocol.score(frame, mask_settings), strict=True
        ):
            if protocol is protocols[0] or mask.any():
                x, y = (None, None) if scored.point is None else map(float, scored.point)
                row = {**common, **asdict(mask_settings), **scored.scores, **columns[text]}
                row |= {"query": text, "protocol": protocol.label, "point_x": x, "point_y": y}
                row |= dict(zip(("height", "width"), mask.shape, strict=True))
                yield {name: row.get(name) for name in load_spec("samples").columns}, scored


class _Recorder:
    """Collector of rows, pictures and costs of a scene."""

    def __init__(self, scene: str, settings: EvaluationSettings):
        self.settings, self.rules = settings, settings.rules
        self.protocols = [load_protocol(name) for name in settings.protocols or PROTOCOLS]
        self.names = {"dataset": settings.dataset, "scene": scene, "method": settings.method}
        self.rows: list[dict[str, Any]] = []
        self.predictions: dict[tuple[str, str, str], np.ndarray] = {}
        self.pictures: dict[str, np.ndarray] = {}
        self.costs: list[dict[str, Any]] = []
        self.constants: dict[str, float] = {}
        self.measured: dict[str, list[float]] = defaultdict(list)

    def measure(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self.measured[name].append(value)

    def evaluate_depths(self, sample: Sample, gaussians: Gaussians) -> None:
        """Score and draw the predicted depths of the context views."""
        depths = view_depths(gaussians, [view.camera for view in sample.context])
        views = list(zip(sample.context, depths, strict=True))
        near, far = pictures.depth_range(*(d if v.depth is None else v.depth for v, d in views))
        self.constants = {"near": near, "far": far}
        for view, depth in views:
            self.pictures[f"depth/{view.name}"] = pictures.paint_depth(depth, near, far)
            if view.depth is not None:
                self.measure(metrics.depth_errors(depth, view.depth, _disparity_scale(sample)))
                painted = pictures.paint_depth(view.depth, near, far)
                self.pictures[f"true_depth/{view.name}"] = painted

    def ask(
        self,
        view: AnsweringView,
        seconds: float,
        frame: str,
        ground: np.ndarray,
        masks: Mapping[str, np.ndarray],
        boxes: Mapping[str, np.ndarray],
        has_truth: bool = True,
        opaque: np.ndarray | None = None,
    ) -> None:
        """Answer, score and draw the queries of a frame, the keys of ``masks``.

        ``seconds`` are those of rendering. Without ``has_truth`` no empty mask is noted as absent.
        Pixels outside ``opaque`` are not scored.
        """
        if not masks:
            return
        if opaque is not None:
            masks = {text: mask & opaque for text, mask in masks.items()}
        rules, hits = self.rules, self._time_queries(view, seconds, frame, list(masks))
        queried = Frame(
            [_answer(hits.get(text), mask, f"{frame!r}: {text!r}") for text, mask in masks.items()],
            list(masks.values()),
            [find_boxes(mask, boxes.get(text)) for text, mask in masks.items()],
            self._segment(view, list(hits), masks),
        ).within(opaque)
        common = {
            **self.names,
            "place": self.settings.place,
            "temperature": rules.temperature,
            "canonical": "encoder's" if rules.phrases is None else ", ".join(rules.phrases),
            "absent": rules.absent,
            "frame": frame,
        }
        columns: dict[str, dict[str, Any]] = {}
        for text, mask in masks.items():
            hit = hits.get(text)
            notes = [] if hit else [NOT_UNDERSTOOD]
            if hit and hit.unknown:
                notes.append(f"unknown: {', '.join(hit.unknown)}")
            if has_truth and not mask.any():
                notes.append(ABSENT)
            columns[text] = {"score": float(hit.score) if hit else None, "note": "; ".join(notes)}
        for row, scored in score_frame(
            queried, list(masks), self.protocols, rules, common, columns
        ):
            self.rows.append(row)
            text, label = row["query"], row["protocol"]
            if scored.mask is not None:
                self.predictions[label, frame, text] = scored.mask
            if self.settings.drawn and label == self.protocols[0].label:
                hit, truth = hits.get(text), masks[text]
                heat = np.zeros(truth.shape, np.float32) if hit is None else hit.relevancy
                drawn = pictures.draw_answer(heat, scored.mask, scored.point, truth, ground)
                for kind, picture in drawn.items():
                    self.pictures[f"{kind}/{frame}/{text}"] = picture

    def _time_queries(
        self, view: AnsweringView, rendering: float, frame: str, queries: Sequence[str]
    ) -> dict[str, Result]:
        """Query the view with the understood texts, and time it."""
        texts = keep_understood(view.reader, queries)
        seconds: dict[str, float | None] = {"view_seconds": None, "query_seconds": None}
        hits: Sequence[Result] = []
        if texts:
            _, first = _measure_time(self.query, view, texts[:1])
            # Query it again with the others: answers must not depend on the timing.
            hits, further = _measure_time(self.query, view, texts)
            seconds = {"view_seconds": rendering + first, "query_seconds": further / len(texts)}
        for query in queries:
            row = {**self.names, "frame": frame, "query": query, **seconds}
            self.costs.append(row if query in texts else row | {"query_seconds": None})
        return dict(zip(texts, hits, strict=True))

    def query(self, view: AnsweringView, texts: Sequence[str]) -> Sequence[Result]:
        hits = view.query_all(texts, **dict(self.rules))
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
        # The protocols assign a class to every pixel, however low its score.
        labels = view.segment(competing, **{**dict(self.rules), "threshold": 0.0})
        places = {text: k + 1 for k, text in enumerate(masks)}
        return np.array([0, *(places[text] for text in competing)], np.int32)[labels]

    def draw_view(self, view: AnsweringView, frame: str) -> None:
        self.pictures[f"render/{frame}"] = view.rgb
        self.pictures[f"ids/{frame}"] = pictures.paint_labels(view.ids, view.rgb)

    def result(self) -> SceneResult:
        leading = [row for row in self.rows if row["protocol"] == self.protocols[0].label]
        means = {name: float(np.mean(values)) for name, values in self.measured.items()}
        memory = {"peak_bytes": system.peak_memory()}
        return SceneResult(
            **self.names,
            rows=self.rows,
            scene_metrics=scene_means(leading) | means | self.constants,
            predictions=self.predictions,
            pictures=self.pictures,
            costs=[row | memory for row in self.costs],
        )


def _answer(hit: Result | None, truth: np.ndarray, place: str) -> Answer:
    """Return the answer for the protocols; an empty one if the text is not understood."""
    if hit is None:
        nothing = np.zeros(truth.shape, np.float32)
        return Answer(nothing, nothing.astype(bool), None)
    for name, array in (("relevancy", hit.relevancy), ("mask", hit.mask)):
        if array.shape != truth.shape:
            raise InputError(f"{place}: the {name} is {array.shape}, expected {truth.shape}")
    low, high = hit.relevancy.min(), hit.relevancy.max()
    if not (low >= 0 and high <= 1):
        raise InputError(
            f"{place}: relevancy goes from {low} to {high}, expected numbers from 0 to 1"
        )
    return Answer(hit.relevancy, hit.mask, hit.point)


def _disparity_scale(sample: Sample) -> float | None:
    """Return focal length times baseline of a rectified pair; None for other contexts."""
    if len(sample.context) != 2:
        return None
    a, b = (view.camera for view in sample.context)
    shift = a.c2w[:3, :3].T @ (b.center - a.center)
    aligned = np.allclose(a.c2w[:3, :3], b.c2w[:3, :3], atol=1e-6) and a.K[0, 0] == b.K[0, 0]
    sideways = np.abs(shift[1:]).max() <= 1e-6 * np.abs(shift[0])
    return float(a.K[0, 0] * np.abs(shift[0])) if aligned and sideways else None
