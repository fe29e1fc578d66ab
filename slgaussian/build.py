"""The road from context views to a field: its steps, their order, and what each may skip.

Every command and every stage goes through these functions: views that are of no use are left out
(:func:`select_usable`), cameras that the matches contradict refused and what is transparent gives
no Gaussian (:func:`predict`) and no label (:func:`label_views`).
"""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from slgaussian.cameras.check import PairCheck, check_pairs, refuse
from slgaussian.cameras.match_graph import match_views
from slgaussian.cameras.quality import Quality, measure
from slgaussian.components.method import Method
from slgaussian.components.registry import KINDS
from slgaussian.copies import are_copies
from slgaussian.datasets.re10k import Clip, encode_clip
from slgaussian.errors import InputError, check_type
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry, SeenView
from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language import CodeStrategy, Encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.masks import MaskProposer, MaskTracker
from slgaussian.masks.associate import associate
from slgaussian.masks.levels import group_objects
from slgaussian.predict import CountingPredictor, Depths, GaussianPredictor, SplatReader
from slgaussian.predict.depth_hypotheses import MIN_MATCHES
from slgaussian.predict.splat_check import check_world
from slgaussian.predict.splat_views import choose_views
from slgaussian.predict.view_graph import verify
from slgaussian.rasterize import rasterize
from slgaussian.rasterize.merging import Change, merge
from slgaussian.scene import Camera, Sample, Scene, View, fit_size, opaque_pixels
from slgaussian.semantic import Lifting
from slgaussian.semantic.lesson import Lesson
from slgaussian.semantic.votes import vote


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
    on_step: Callable[[str, float], None] = lambda step, seconds: None,
) -> SemanticField:
    """Build a queryable semantic field from the context views of a sample (paper, figure 2).

    Views that show another place, or repeat another view, are excluded with a warning
    (:func:`select_usable`).

    Args:
        sample: Its targets and ground truth are not used.
        method: Components and their settings; the default, ``Method()``, needs no weights.
        trust_cameras: If true, accept cameras that the matches between the photographs contradict.
        on_step: Called with the name and seconds of each finished step.

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
    # Loaded before the work, so that what is invalid costs none.
    encoder, codes, lifting = (c.load() for c in (method.encoder, method.codes, method.lifting))
    sample, predicted, label_maps = label_photographs(sample, method, trust_cameras, on_step)
    gaussians, geometry, quality, depths = predicted
    with _time_step("supervision", on_step):
        drawing = codes, method.seed, method.bank
        bank = build_memory_bank(sample, geometry, label_maps, encoder, *drawing)
    with _time_step("field", on_step):
        return lift_field(sample, gaussians, label_maps, bank, lifting, method, quality, depths)


def label_photographs(
    sample: Sample,
    method: Method,
    trust_cameras: bool = False,
    on_step: Callable[[str, float], None] = lambda step, seconds: None,
) -> tuple[Sample, Predicted, LabelMaps]:
    """Do the first steps of :func:`build_field`, up to the label maps; return the usable views too.

    Raises:
        InputError: As :func:`build_field`.
    """
    predictor, proposer, tracker = (
        component.load() for component in (method.predictor, method.proposer, method.tracker)
    )
    if isinstance(predictor, SplatReader):
        sample = choose_views(sample, predictor.read(sample.scene))
    sample, left_out = select_usable(sample)
    for name, reason in left_out.items():
        warnings.warn(f"{name} is left out: {reason}", stacklevel=3)
    with _time_step("geometry", on_step):
        predicted = predict(sample, predictor, method.seed, trust_cameras)
    with _time_step("masks", on_step):
        votes = method.replicas, method.votes
        label_maps = label_views(predicted.geometry, proposer, tracker, *votes)
    return sample, predicted, label_maps


def select_usable(sample: Sample) -> tuple[Sample, dict[str, str]]:
    """Match context views, and drop those that are duplicates or that match no other view.

    A duplicate has the picture and camera of an earlier view, and would count as independent
    evidence. Views without matches remain if there are only two, or if more than half would go.

    Returns:
        sample: Sample. The remaining context views, with their matches.
        left_out: {view name: reason}
    """
    views: list[View] = []
    left_out = {}
    for view in sample.context:
        same = [earlier.name for earlier in views if _same(earlier, view)]
        if same:
            left_out[view.name] = f"it is the same picture as {same[0]}, from the same place"
        else:
            views.append(view)
    if left_out:
        sample = replace(sample, context=tuple(views), matches=None)
    sample = replace(sample, matches=match_views(sample))
    if len(views) == 2:
        return sample, left_out
    # In the coordinates of the predictor, which reads the same verified matches.
    verified = verify(sample.localize()[0].context, match_views(sample))
    matched = {i for pair in verified[0] for i in pair}
    if max(3, len(views) / 2) <= len(matched) < len(views):
        reason = f"fewer than {MIN_MATCHES} matches with any other tell its depth"
        left_out |= {view.name: reason for i, view in enumerate(views) if i not in matched}
        # Matched again, as the neighbours of a view are different ones now.
        few = replace(sample, context=tuple(views[i] for i in sorted(matched)), matches=None)
        return replace(few, matches=match_views(few)), left_out
    return replace(sample, matches=replace(match_views(sample), verified=verified)), left_out


def _same(a: View, b: View) -> bool:
    same_camera = np.allclose(a.camera.c2w, b.camera.c2w) and np.allclose(a.camera.K, b.camera.K)
    return bool(
        same_camera and (np.array_equal(a.image, b.image) or are_copies(a.thumbnail, b.thumbnail))
    )


def make_clip(
    scene: Scene, checked: bool = True, trust_cameras: bool = False
) -> tuple[Clip, list[InputError]]:
    """Encode the usable photographs of a scene as a clip; return why others are left out, too.

    Given cameras are checked as those of a field, unless they are exact (``checked`` is false).

    Raises:
        InputError: As :func:`check_cameras`, and if no photograph can be read.
    """
    shrunk: dict[str, View] = {}

    def read(name: str) -> View:
        view = scene.read(name)
        height, width = view.image.shape[:2]
        shrunk[name] = view.resize(*fit_size(height, width, "auto"))
        return view

    errors: list[InputError] = []
    clip = encode_clip(replace(scene, read=read), errors.append)
    unused = dict(scene.left_out)
    if checked and not scene.estimation and len(shrunk) > 1:
        sample = replace(scene, read=shrunk.__getitem__).sample(list(shrunk))
        sample, useless = select_usable(sample)
        check_cameras(sample, trust_cameras)
        if useless:
            cameras = {view.name: scene.cameras[view.name] for view in sample.context}
            clip, unused = encode_clip(replace(scene, cameras=cameras)), {**unused, **useless}
    return clip, errors + [InputError(f"{name}: {reason}") for name, reason in unused.items()]


def check_cameras(sample: Sample, trust_cameras: bool = False) -> list[PairCheck]:
    """Check the cameras of context views by their matches.

    Raises:
        InputError: As :func:`slgaussian.cameras.check.refuse`, unless ``trust_cameras``.
    """
    checks = check_pairs(sample)
    if not trust_cameras:
        refuse(sample.scene, checks, any(view.camera.estimated for view in sample.context))
    return checks


def predict(
    sample: Sample, predictor: GaussianPredictor, seed: int, trust_cameras: bool = False
) -> Predicted:
    """Predict Gaussians from context views and their matches (paper, section 3.1).

    Transparent pixels give none.

    Raises:
        InputError: As :func:`check_cameras` and as the predictor, and if a Gaussian is invalid.
    """
    sample = replace(sample, matches=match_views(sample))
    checks, depths = check_cameras(sample, trust_cameras), None
    if isinstance(predictor, SplatReader):
        gaussians = predictor.read(sample.scene)
        agreement = check_world(gaussians, sample.context, trust_cameras)
        geometry = SceneGeometry.of(sample.context, gaussians)
        quality, _ = measure(geometry, checks)
        quality = replace(quality, detail=agreement.detail, psnr=agreement.psnr)
        return Predicted(gaussians, geometry, quality, None)
    # No predictor, of another package either, has to know of far cameras and other units.
    local, frame = sample.localize()
    if isinstance(predictor, CountingPredictor):
        gaussians, depths = predictor.predict_with_counts(local, seed)
    else:
        gaussians = predictor(local, seed)
    gaussians = gaussians.place(frame)
    gaussians.check()
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
    proposer: MaskProposer,
    tracker: MaskTracker,
    replicas: int,
    votes: str = "views",
    targets: Sequence[SeenView] = (),
) -> LabelMaps:
    """Compute consistent object ids of the context views (paper, section 3.2, Mask Association).

    Those of ``targets``, if given, come after them: their objects are those of the context views,
    as others have no code. Transparent pixels have no object.
    """
    frames = [*geometry.frames, *targets]
    maps = associate(frames, proposer, tracker, replicas, votes)
    labels, opaque = maps.labels, opaque_pixels([frame.view for frame in frames])
    if opaque is not None:
        labels = np.where(opaque, labels, 0)
    if targets:
        context = labels[: len(geometry.frames)]
        labels = np.where(np.isin(labels, np.unique(context)), labels, 0)
    return replace(maps, labels=labels)


def make_lesson(
    sample: Sample,
    gaussians: Gaussians,
    proposer: MaskProposer,
    tracker: MaskTracker,
    replicas: int,
    votes: str = "views",
) -> Lesson:
    """Label the context and target views of a sample for the training of the branch."""
    geometry, targets = SceneGeometry.of(sample.context, gaussians), see_targets(sample, gaussians)
    label_maps = label_views(geometry, proposer, tracker, replicas, votes, targets)
    context, others = (maps.labels for maps in label_maps.split(len(sample.context)))
    cameras, opaque = tuple(v.camera for v in sample.targets), opaque_pixels(sample.targets)
    return Lesson(sample.scene, gaussians, context, cameras, others, opaque)


def build_memory_bank(
    sample: Sample,
    geometry: SceneGeometry,
    label_maps: LabelMaps,
    encoder: Encoder,
    codes: CodeStrategy,
    seed: int,
    entries: str = "groups",
) -> MemoryBank:
    """Draw an ID code for every object and encode the object in each view (section 3.2).

    Groups of objects (:func:`slgaussian.masks.levels.group_objects`) are encoded too, unless
    ``entries`` is ``objects`` (:class:`slgaussian.components.method.BuildConfig`).
    """
    drawn = codes(label_maps, rng_for(seed, sample.content, "codes"))
    grouped = entries == "groups" and len(label_maps.ids) > 0
    groups = group_objects(geometry.frames, label_maps) if grouped else (None, None)
    surroundings = geometry.surroundings
    return build_bank(sample.context, label_maps, encoder, drawn, surroundings, *groups)


def lift_field(
    sample: Sample,
    gaussians: Gaussians,
    label_maps: LabelMaps,
    bank: MemoryBank,
    lifting: Lifting,
    method: Method,
    quality: Quality,
    depths: Depths | None = None,
) -> SemanticField:
    """Combine base Gaussians, labels and bank to a field (section 3.1, Semantic Parameters).

    Its settings record method, quality of the views and statistics. With ``method.keep`` "needed"
    its Gaussians are merged: code that needs one Gaussian per pixel must use the unmerged input.
    """
    cameras = {view.name: _with_confidence(view.camera, quality) for view in sample.context}
    if gaussians.pixelwise:
        lifted = lifting(gaussians, label_maps, bank)
    elif method.lifting.name == KINDS["lifting"].default:
        lifted = vote(gaussians, label_maps, bank, [view.camera for view in sample.context])
    else:
        raise InputError(
            f"lifting {method.lifting.name!r}: needs a Gaussian for each pixel, and those of a "
            "splat that exists are of none; leave it out, and the views vote"
        )
    change = Change()
    if method.keep == "needed" and gaussians.pixelwise:
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
        settings["cameras"] = record_estimation(sample, quality)
    if not gaussians.pixelwise:
        origin = f"renderings {sample.rendered}" if sample.rendered else "photographs"
        settings["views"] = {"kind": origin, "names": [view.name for view in sample.context]}
        settings["lifting"] = "votes"
    return SemanticField(lifted, bank, cameras, settings, method.encoder.places())


def record_estimation(sample: Sample, quality: Quality) -> dict[str, Any]:
    """Return how the cameras were estimated, with their confidence by the scene; empty if given."""
    if not sample.estimation:
        return {}
    confidence = round(quality.camera_confidence(sample.estimation["confidence"]), 3)
    return {**sample.estimation, "confidence": confidence}


def _with_confidence(camera: Camera, quality: Quality) -> Camera:
    """Return a camera with the confidence that the scene gives it, if it was estimated."""
    if camera.estimated is None:
        return camera
    confidence = quality.camera_confidence(camera.estimated.confidence)
    return replace(camera, estimated=replace(camera.estimated, confidence=confidence))


@contextmanager
def _time_step(step: str, on_step: Callable[[str, float], None]) -> Iterator[None]:
    start = time.perf_counter()
    yield
    on_step(step, time.perf_counter() - start)


def _size(arrays: Mapping[str, np.ndarray]) -> int:
    return sum(array.nbytes for array in arrays.values())
