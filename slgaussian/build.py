"""The whole method, from context views to a field, as separate steps."""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from slgaussian.cameras.check import PairCheck, check_pairs, refuse
from slgaussian.cameras.match_graph import MatchGraph
from slgaussian.cameras.quality import Quality, measure
from slgaussian.components.config import ComponentConfig
from slgaussian.components.method import Method
from slgaussian.errors import check_type
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.masks.associate import associate
from slgaussian.masks.levels import group_objects
from slgaussian.predict import CountingPredictor, Depths, GaussianPredictor
from slgaussian.predict.view_graph import select_usable
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.merging import Change, merge
from slgaussian.scene import Camera, Sample, opaque_pixels


class Predicted(NamedTuple):
    """Output of a predictor for the context views.

    Attributes:
        gaussians: With the array ``guessed``.
        quality: Quality of the views.
        depths: Numbers of depth candidates; None if the predictor does not count them.
    """

    gaussians: Gaussians
    geometry: SceneGeometry
    quality: Quality
    depths: Depths | None


def build_field(
    sample: Sample,
    method: Method | None = None,
    trust_cameras: bool = False,
    took: Callable[[str, float], None] = lambda step, seconds: None,
) -> SemanticField:
    """Build a queryable semantic field from the context views of a sample (paper, figure 2).

    Views that show another place, or repeat another view, are excluded with a warning
    (:func:`slgaussian.predict.view_graph.select_usable`).

    Args:
        sample: Its targets and ground truth are not used.
        method: Components and their settings; the default, ``Method()``, needs no weights.
        trust_cameras: If true, accept cameras that the matches between the photographs contradict.
        took: Called with the name and seconds of each finished step.

    Returns:
        SemanticField: Its ``settings`` are :meth:`slgaussian.components.method.Method.identity`
            and: ``quality``, the :class:`slgaussian.cameras.quality.Quality` of the views;
            ``verdict``, the expected quality of the scene; ``account``, counts and sizes;
            ``cameras``, if they were estimated, the way in which they were.

    Raises:
        InputError: If a setting is out of range, a checkpoint does not fit, the views cannot be
            used, or the cameras contradict the photographs.
    """
    check_type(sample, Sample, "build_field: expected a Sample, as slg.photographs returns it")
    method = method or Method()
    check_type(method, Method, "build_field: expected a Method, such as slg.Method(encoder='clip')")
    sample, predicted, label_maps = label_photographs(sample, method, trust_cameras, took)
    gaussians, geometry, quality, depths = predicted
    with _timed("supervision", took):
        components = method.encoder, method.codes, method.seed, method.bank
        bank = build_memory_bank(sample, geometry, label_maps, *components)
    with _timed("field", took):
        return lift_field(sample, gaussians, label_maps, bank, method, quality, depths)


def label_photographs(
    sample: Sample,
    method: Method,
    trust_cameras: bool = False,
    took: Callable[[str, float], None] = lambda step, seconds: None,
) -> tuple[Sample, Predicted, LabelMaps]:
    """Do the first steps of :func:`build_field`, up to the label maps; return the usable views too.

    Raises:
        InputError: As :func:`build_field`.
    """
    method.check()
    sample, graph, left_out = select_usable(sample)
    for name, reason in left_out.items():
        warnings.warn(f"{name} is left out: {reason}", stacklevel=3)
    with _timed("geometry", took):
        predicted = predict(sample, graph, method.predictor, method.seed, trust_cameras)
    with _timed("masks", took):
        masking = method.proposer, method.tracker, method.replicas, method.votes
        label_maps = label_views(predicted.geometry, *masking)
    return sample, predicted, label_maps


def check_cameras(
    sample: Sample, graph: MatchGraph, trust_cameras: bool = False
) -> list[PairCheck]:
    """Check the cameras of context views by their matches.

    Raises:
        InputError: As :func:`slgaussian.cameras.check.refuse`, unless ``trust_cameras``.
    """
    checks = check_pairs(sample.context, graph)
    if not trust_cameras:
        refuse(sample.scene, checks, any(view.camera.estimated for view in sample.context))
    return checks


def predict(
    sample: Sample,
    graph: MatchGraph,
    predictor: ComponentConfig | GaussianPredictor,
    seed: int,
    trust_cameras: bool = False,
) -> Predicted:
    """Predict Gaussians from context views and their matches (paper, section 3.1).

    Transparent pixels give none. ``predictor`` is loaded first if it is a component.

    Raises:
        InputError: As :func:`check_cameras` and as the predictor.
    """
    checks = check_cameras(sample, graph, trust_cameras)
    loaded, depths = predictor.load() if isinstance(predictor, ComponentConfig) else predictor, None
    # No predictor, of another package either, has to know of far cameras and other units.
    local, frame = sample.localize()
    if isinstance(loaded, CountingPredictor):
        gaussians, depths = loaded.counted(local, seed, graph)
    else:
        gaussians = loaded(local, seed, graph)
    gaussians = gaussians.place(frame)
    opaque = opaque_pixels(sample.context)
    if opaque is not None:
        gaussians = gaussians[opaque.ravel()[gaussians.to_arrays()["source"]]]
    geometry = SceneGeometry.of(sample.context, gaussians)
    quality, confirmed = measure(geometry, checks)
    arrays = gaussians.to_arrays()
    guessed = ~confirmed.ravel()[arrays["source"]] | arrays.get("guessed", False)
    return Predicted(gaussians.with_arrays(guessed=guessed), geometry, quality, depths)


def see_targets(sample: Sample, gaussians: Gaussians) -> list[SeenView]:
    """Return the targets with the rendered depth of the context's Gaussians.

    Mean depth would put a surface between foreground and background at edges, so it is the median.
    """
    nothing = torch.zeros(len(gaussians), 1)
    targets = []
    for view in sample.targets:
        median = rasterize(gaussians, nothing, view.camera, median=True).median
        assert median is not None  # as it is asked for
        local = replace(view, camera=gaussians.localize(view.camera))  # as the context's
        targets.append(SeenView(local, median.numpy()))
    return targets


def label_views(
    geometry: SceneGeometry,
    proposer: ComponentConfig,
    tracker: ComponentConfig,
    replicas: int,
    votes: str = "views",
    targets: Sequence[SeenView] = (),
) -> LabelMaps:
    """Compute consistent object ids of the context views (paper, section 3.2, Mask Association).

    Those of ``targets``, if given, come after them: their objects are those of the context views,
    as others have no code. Transparent pixels have no object.
    """
    frames = [*geometry.frames, *targets]
    maps = associate(frames, proposer.load(), tracker.load(), replicas, votes)
    labels, opaque = maps.labels, opaque_pixels([frame.view for frame in frames])
    if opaque is not None:
        labels = np.where(opaque, labels, 0)
    if targets:
        context = labels[: len(geometry.frames)]
        labels = np.where(np.isin(labels, np.unique(context)), labels, 0)
    return replace(maps, labels=labels)


def build_memory_bank(
    sample: Sample,
    geometry: SceneGeometry,
    label_maps: LabelMaps,
    encoder: ComponentConfig,
    codes: ComponentConfig,
    seed: int,
    entries: str = "groups",
) -> MemoryBank:
    """Draw an ID code for every object and encode the object in each view (section 3.2).

    Groups of objects (:func:`slgaussian.masks.levels.group_objects`) are encoded too, unless
    ``entries`` is ``objects`` (:class:`slgaussian.components.method.BuildConfig`).
    """
    drawn = codes.load()(label_maps, rng_for(seed, sample.content, "codes"))
    grouped = entries == "groups" and len(label_maps.ids) > 0
    groups = group_objects(geometry.frames, label_maps) if grouped else (None, None)
    surroundings = geometry.surroundings
    return build_bank(sample.context, label_maps, encoder.load(), drawn, surroundings, *groups)


def lift_field(
    sample: Sample,
    gaussians: Gaussians,
    label_maps: LabelMaps,
    bank: MemoryBank,
    method: Method,
    quality: Quality,
    depths: Depths | None = None,
) -> SemanticField:
    """Combine base Gaussians, labels and bank to a field (section 3.1, Semantic Parameters).

    Its settings record method, quality of the views and statistics. With ``method.keep`` "needed"
    its Gaussians are merged: code that needs one Gaussian per pixel must use the unmerged input.
    """
    cameras = {view.name: _with_confidence(view.camera, quality) for view in sample.context}
    lifted = method.lifting.load()(gaussians, label_maps, bank)
    change = Change()
    if method.keep == "needed":
        merged = merge(lifted, list(cameras.values()))
        lifted, change = merged.gaussians, merged.change
    settings = {"scene": sample.scene, **method.identity(), "quality": quality.as_json()}
    settings["verdict"] = quality.verdict()._asdict()
    settings["account"] = {
        "gaussians_made": len(gaussians),
        "gaussians_kept": len(lifted),
        # Between renderings of the context views before and after merging, grey levels.
        "change_mean": round(change.mean, 4),
        "change_rms": round(change.rms, 4),
        "change_greatest": round(change.greatest, 4),
        "replicas_asked": method.replicas,
        "bytes_gaussians": _size(lifted.to_arrays()),
        "bytes_bank": _size(bank.to_arrays()),
        "replicas_computed": label_maps.computed,  # the other copies of a view are identical
        "depths_tried": None if depths is None else depths.tried,
        "depths_possible": None if depths is None else depths.possible,
    }
    if sample.estimation:
        confidence = round(quality.camera_confidence(sample.estimation["confidence"]), 3)
        settings["cameras"] = {**sample.estimation, "confidence": confidence}
    return SemanticField(lifted, bank, cameras, settings, method.encoder.places())


def _with_confidence(camera: Camera, quality: Quality) -> Camera:
    """Return a camera with the confidence that the scene gives it, if it was estimated."""
    if camera.estimated is None:
        return camera
    confidence = quality.camera_confidence(camera.estimated.confidence)
    return replace(camera, estimated=replace(camera.estimated, confidence=confidence))


@contextmanager
def _timed(step: str, took: Callable[[str, float], None]) -> Iterator[None]:
    start = time.perf_counter()
    yield
    took(step, time.perf_counter() - start)


def _size(arrays: Mapping[str, np.ndarray]) -> int:
    return sum(array.nbytes for array in arrays.values())
