"""Score one field against the truth of its scene, and draw what the numbers mean."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from data_specs import load_spec
from slgaussian.benchmark import metrics, pictures
from slgaussian.errors import InputError
from slgaussian.gaussians import source_depths
from slgaussian.labels import LabelMaps
from slgaussian.language.query import Rules
from slgaussian.scene import Camera, Sample, View

if TYPE_CHECKING:
    from slgaussian.field import FieldView, SemanticField
    from slgaussian.language.query import QueryResult

ALONG_THE_WAY = {"quarter way": 0.25, "halfway": 0.5, "three-quarter way": 0.75}
"""Viewpoints between the first two context cameras that are drawn, by frame name. Queries without
truth are asked halfway."""

ERROR_TOP = 0.2
"""Relative depth error that is drawn white."""

NOT_UNDERSTOOD = "not understood"
"""Note of a row whose query the encoder refuses: no known word, or one it cannot use."""


@dataclass(frozen=True, eq=False)
class SceneResult:
    """Everything that is reported of one scene and one method.

    Attributes
    ----------
    scene : str
    rows : list of dict
        One a (frame, query), with the columns of the data spec ``samples``.
    scene_metrics : {name: float}
        ``iou``, ``hit_mask``, ``hit_box`` (means over the rows with truth), ``miou``, ``psnr``,
        ``ssim`` (means over targets), ``abs_rel``, ``delta125`` (context views), ``bad2`` (the
        same, rectified pairs only), ``target_abs_rel``, ``target_delta125`` (rendered); those
        without truth are absent. ``near`` and ``far`` are the ends of the depth colours.
    predictions : {(frame, query): bool [H, W]}
    pictures : {name: uint8 [H, W, 3]}
        ``<kind>/<frame>`` or ``<kind>/<frame>/<query>``; kinds: ``input``, ``labels``, ``depth``,
        ``true_depth``, ``depth_error`` (context views), ``photo``, ``render``, ``ids`` (targets
        and viewpoints along the way), ``relevancy`` and ``mask`` (queries); and ``objects/all``,
        every object of the memory bank cut from a photograph, with its id.
    times : {stage: float}
        Seconds, summed over the scene: ``render``, ``query``, ``segment``. Volatile.
    """

    scene: str
    rows: list[dict[str, Any]]
    scene_metrics: dict[str, float]
    predictions: dict[tuple[str, str], np.ndarray]
    pictures: dict[str, np.ndarray]
    times: dict[str, float]


def truth_from_instances(sample: Sample) -> dict[str, dict[str, np.ndarray]]:
    """Masks bool [H, W] by target view and phrase, from the true instance ids.

    Instances with one phrase are united; an instance that the view does not show is left out.
    """
    truth: dict[str, dict[str, np.ndarray]] = {}
    for view in sample.targets:
        masks = truth.setdefault(view.name, {})
        if view.instances is None:
            continue
        for instance, phrase in sample.phrases.items():
            seen = view.instances == instance
            if seen.any():
                masks[phrase] = masks.get(phrase, False) | seen
    return truth


def evaluate(
    field: SemanticField,
    sample: Sample,
    label_maps: LabelMaps,
    truth: Mapping[str, Mapping[str, np.ndarray]],
    *,
    boxes: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    queries: Sequence[str] = (),
    method: str = "slgaussian",
    rules: Rules | None = None,
) -> SceneResult:
    """Ask the field everything the truth knows, in every target view.

    Parameters
    ----------
    field : SemanticField
    sample : Sample
        The one the field was built from; its targets carry the photographs to compare with.
    label_maps : LabelMaps
        Of the context views, for the pictures.
    truth : {target name: {query: bool [H, W]}}
        An empty mask means that the frame has no truth for the query: asked, reported, not scored.
    boxes : {target name: {query: float [n, 4]}}, optional
        Annotated boxes (x0, y0, x1, y1); without them, the bounding box of each mask.
    queries : sequence of str
        Asked without truth, midway between the first two context cameras.
    method : str
        Name of what made the field, written into every row.
    rules : Rules, optional
        How texts become answers, if not in the default way.

    Returns
    -------
    SceneResult
        A query that is not understood is a row with IoU 0 and no hit, never left out.

    Raises
    ------
    InputError
        If a frame of ``truth`` is not a target, or a mask does not have its size.
    """
    _check_truth(sample, truth)
    record = _Record(sample.scene, method, rules or Rules())
    for target in sample.targets:
        with record.stage("render"):
            view = field.render(target.camera)
        masks = truth.get(target.name, {})
        for query, mask in masks.items():
            box = None if boxes is None else boxes[target.name][query]
            record.ask(view, target.name, query, target.image, mask, box)
        record.segment(view, target.name, masks)
        record.score("psnr", metrics.psnr(view.rgb, target.image))
        record.score("ssim", metrics.ssim(view.rgb, target.image))
        record.score_depth(view.depth, target, prefix="target_")
        record.pictures[f"photo/{target.name}"] = target.image
        record.draw_view(view, target.name)

    first, second = (view.camera for view in sample.context[:2])
    for frame, step in ALONG_THE_WAY.items():
        with record.stage("render"):
            view = field.render(camera_between(first, second, step))
        record.draw_view(view, frame)
        if frame == "halfway":
            for query in queries:
                record.ask(view, frame, query, view.rgb)

    depths = source_depths(field.gaussians, [view.camera for view in sample.context])
    known = [d if v.depth is None else v.depth for v, d in zip(sample.context, depths, strict=True)]
    near, far = pictures.depth_range(*known)
    for view, depth, labels in zip(sample.context, depths, label_maps.labels, strict=True):
        record.score_depth(depth, view, _disparity_scale(sample))
        record.pictures |= _context_pictures(view, depth, labels, near, far)
    if field.bank.boxes is not None:
        images = [view.image for view in sample.context]
        cuts = pictures.cut_out(images, label_maps.labels, field.bank.ids, field.bank.boxes)
        tiles = list(zip(map(str, field.bank.ids), cuts, strict=True))
        record.pictures["objects/all"] = pictures.contact_sheet(tiles, side=56, columns=8)
    return record.result({"near": near, "far": far})


class _Record:
    """What has been found out so far."""

    def __init__(self, scene: str, method: str, rules: Rules):
        self.scene = scene
        self.rules = asdict(rules)
        self.rows: list[dict[str, Any]] = []
        self.predictions: dict[tuple[str, str], np.ndarray] = {}
        self.pictures: dict[str, np.ndarray] = {}
        self.seconds = {"render": 0.0, "query": 0.0, "segment": 0.0}
        self._scores: dict[str, list[float]] = {}
        self._common = {
            "scene": scene,
            "method": method,
            "protocol": rules.selection,
            "share": rules.share if rules.selection == "near-best" else None,
            "threshold": rules.threshold,
            "temperature": rules.temperature,
            "canonical": "encoder's" if rules.phrases is None else ", ".join(rules.phrases),
            "absent": rules.absent,
        }

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - start

    def score(self, name: str, value: float) -> None:
        self._scores.setdefault(name, []).append(value)

    def score_depth(
        self, depth: np.ndarray, view: View, scale: float | None = None, prefix: str = ""
    ) -> None:
        if view.depth is not None:
            for name, value in metrics.depth_errors(depth, view.depth, scale).items():
                self.score(prefix + name, value)

    def ask(
        self,
        view: FieldView,
        frame: str,
        query: str,
        ground: np.ndarray,
        mask: np.ndarray | None = None,
        boxes: np.ndarray | None = None,
    ) -> None:
        """Answer, score and draw one query; ``mask`` None or empty: there is no truth."""
        notes = []
        hit = None
        if not _understands(query, view):
            notes.append(NOT_UNDERSTOOD)
        else:
            with self.stage("query"):
                hit = view.query(query, **self.rules)
                hit.mask, hit.relevancy, hit.point  # noqa: B018  (drawn when first looked at)
            if hit.unknown:
                notes.append(f"unknown: {', '.join(hit.unknown)}")
            for word, (other, likeness) in hit.taken_for.items():
                notes.append(f"{word} taken for {other} ({likeness:.2f})")
        if mask is not None and not mask.any():
            mask = None
            notes.append("not in this frame")
        found = np.zeros(ground.shape[:2], bool) if hit is None else hit.mask
        point = None if hit is None else hit.point
        row = self._common | {
            "frame": frame,
            "query": query,
            "iou": None,
            "hit_mask": None,
            "hit_box": None,
            "hit_peak": None,
            "score": None if hit is None else hit.score,
            "point_x": None if point is None else float(point[0]),
            "point_y": None if point is None else float(point[1]),
            "note": "; ".join(notes),
        }
        if mask is not None:
            boxes = _bounding_box(mask) if boxes is None else boxes
            row["iou"] = metrics.iou(found, mask)
            row["hit_mask"] = metrics.point_in_mask(point, mask)
            row["hit_box"] = metrics.point_in_boxes(point, boxes)
            row["hit_peak"] = hit is not None and metrics.any_in_boxes(hit.peak, boxes)
            for name in ("iou", "hit_mask", "hit_box"):
                self.score(name, float(row[name]))
        self.rows.append({name: row[name] for name in load_spec("samples").columns})
        self.predictions[frame, query] = found
        self._draw_query(f"{frame}/{query}", hit, found, mask, ground)

    def segment(self, view: FieldView, frame: str, masks: Mapping[str, np.ndarray]) -> None:
        """Score the closed-set segmentation by all queries of the frame."""
        if not any(mask.any() for mask in masks.values()):
            return
        unknown = {
            row["query"]
            for row in self.rows
            if row["frame"] == frame and row["note"].startswith(NOT_UNDERSTOOD)
        }
        # Texts that are not understood come last: they win no pixel, so their classes score 0.
        texts = sorted(masks, key=lambda text: text in unknown)
        labels = np.zeros(view.ids.shape, np.int32)
        if len(unknown) < len(texts):
            with self.stage("segment"):
                labels = view.segment(texts[: len(texts) - len(unknown)], **self.rules)
        self.score("miou", metrics.mean_iou(labels, [masks[text] for text in texts]))

    def draw_view(self, view: FieldView, frame: str) -> None:
        self.pictures[f"render/{frame}"] = view.rgb
        self.pictures[f"ids/{frame}"] = pictures.paint_labels(view.ids, view.rgb)

    def _draw_query(
        self,
        name: str,
        hit: QueryResult | None,
        found: np.ndarray,
        mask: np.ndarray | None,
        ground: np.ndarray,
    ) -> None:
        heat = np.zeros(found.shape, np.float32) if hit is None else hit.relevancy
        painted = pictures.paint_relevancy(heat, ground)
        answer = pictures.draw_outline(pictures.spotlight(ground, found), found, pictures.PREDICTED)
        if mask is not None:
            painted = pictures.draw_outline(painted, mask, pictures.TRUE)
            answer = pictures.draw_outline(answer, mask, pictures.TRUE)
        self.pictures[f"relevancy/{name}"] = pictures.draw_point(painted, hit and hit.point)
        self.pictures[f"mask/{name}"] = pictures.draw_point(answer, hit and hit.point)

    def result(self, constants: Mapping[str, float]) -> SceneResult:
        means = {name: float(np.mean(values)) for name, values in self._scores.items()}
        return SceneResult(
            scene=self.scene,
            rows=self.rows,
            scene_metrics=means | dict(constants),
            predictions=self.predictions,
            pictures=self.pictures,
            times=self.seconds,
        )


def camera_between(a: Camera, b: Camera, t: float) -> Camera:
    """The camera at share ``t`` of the way from ``a`` to ``b``: straight path, slerped rotation.

    Intrinsics are interpolated too; the image size is that of ``a``.
    """
    turn = Slerp([0, 1], Rotation.from_matrix([a.c2w[:3, :3], b.c2w[:3, :3]]))
    c2w = np.eye(4)
    c2w[:3, :3] = turn(t).as_matrix()
    c2w[:3, 3] = (1 - t) * a.center + t * b.center
    return replace(a, K=(1 - t) * a.K + t * b.K, c2w=c2w)


def _context_pictures(
    view: View, depth: np.ndarray, labels: np.ndarray, near: float, far: float
) -> dict[str, np.ndarray]:
    drawn = {
        f"input/{view.name}": view.image,
        f"labels/{view.name}": pictures.paint_labels(labels, view.image),
        f"depth/{view.name}": pictures.paint_depth(depth, near, far),
    }
    if view.depth is not None:
        known = view.depth > 0
        truth = np.where(known, view.depth, 1).astype(np.float64)
        drawn[f"true_depth/{view.name}"] = pictures.paint_depth(view.depth, near, far)
        drawn[f"depth_error/{view.name}"] = pictures.paint_error(
            np.abs(depth - truth) / truth, known, ERROR_TOP
        )
    return drawn


def _understands(text: str, view: FieldView) -> bool:
    try:
        view.reader.unknown_words(text)
    except InputError:
        return False
    return True


def _bounding_box(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    return np.array([[columns[0], rows[0], columns[-1], rows[-1]]], np.float64)


def _disparity_scale(sample: Sample) -> float | None:
    """Focal length times baseline if the context is one rectified pair, the only kind of pair in
    which a disparity is one number of pixels."""
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
