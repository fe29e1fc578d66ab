"""The whole method, from two photographs to a field, as a few steps that can run on their own."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from slgaussian.cameras.check import check_cameras, check_pairs
from slgaussian.cameras.quality import Quality, measure
from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.kernels import compiling
from slgaussian.kernels.seeding import rng_for
from slgaussian.labels import LabelMaps
from slgaussian.language import ENCODERS, load_codes, load_encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.language.named import true_names
from slgaussian.language.room import find_room
from slgaussian.masks import load_proposer, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.levels import group_objects
from slgaussian.parts.identity import PartSettings, described, places
from slgaussian.parts.registry import resolve
from slgaussian.predict import load_predictor
from slgaussian.scene import Sample
from slgaussian.semantic import load_lifting


def build_field(
    sample: Sample,
    predictor: str = "planesweep",
    proposer: str = "regions",
    tracker: str = "geometric",
    encoder: str = "lexicon",
    codes: str = "separated",
    lifting: str = "hard",
    replicas: int = 5,
    seed: int = 0,
    settings: PartSettings | None = None,
    trust_cameras: bool = False,
) -> SemanticField:
    """From the context views of a sample to a field that answers words (paper, figure 2).

    Parameters
    ----------
    sample : Sample
        Its targets are not looked at, nor its truths, but by the encoder ``named``.
    predictor, proposer, tracker, encoder, codes, lifting : str
        The method of each part, by its name in the registry of its package.
    replicas : int
        How many copies of each view vote on its labels (five in the paper, section 3.2).
    seed : int
        Of everything random: the planes that fill depth, and the ID codes. The same seed gives
        the same bytes, whatever scene and views are called.
    settings : mapping, optional
        Settings of these parts, each under its name (see its class):
        ``{"mvsplat": {"checkpoint": "re10k.ckpt"}, "sam": {"model": "facebook/sam-vit-base"}}``.
    trust_cameras : bool
        Do not refuse cameras that the matches between the photographs contradict.

    Returns
    -------
    SemanticField
        Its own ``settings`` say all this, see :func:`slgaussian.parts.identity.described`, and
        under ``quality`` how good the views were, see :class:`slgaussian.cameras.quality.Quality`.

    Raises
    ------
    InputError
        If a name or a setting is unknown, a checkpoint does not fit, the views cannot be used, or
        their cameras are not theirs; the message says which and why.
    """
    settings = _with_defaults(encoder, settings or {})
    check_parts(predictor, proposer, tracker, encoder, codes, lifting, settings)
    made_by = described(settings)
    compiling.watch()
    gaussians = predict(sample, predictor, seed, settings, trust_cameras)
    label_maps = label_views(sample, gaussians, proposer, tracker, replicas, settings)
    bank = remember(sample, gaussians, label_maps, encoder, codes, seed, settings)
    about = {
        "scene": sample.scene,
        "predictor": predictor,
        "proposer": proposer,
        "tracker": tracker,
        "encoder": encoder,
        "codes": codes,
        "lifting": lifting,
        "replicas": replicas,
        "seed": seed,
        **made_by,
    }
    where = places(settings.get(encoder, {}))
    own = settings.get(lifting, {})
    return lift_field(sample, gaussians, label_maps, bank, lifting, about, where, own)


def check_parts(
    predictor: str,
    proposer: str,
    tracker: str,
    encoder: str,
    codes: str,
    lifting: str,
    settings: PartSettings,
) -> None:
    """Load every part once, so that what cannot work is said before the others have worked.

    Raises
    ------
    InputError
        If no part has one of these names, settings are of another part than these, or files do
        not fit.
    """
    takers = predictor, proposer, tracker, encoder, codes, lifting
    for name in settings:
        if name not in takers:
            raise InputError(
                f"settings: found some of {name!r}, expected none but those of the predictor, "
                "proposer, tracker, encoder, codes and lifting, which are "
                f"{', '.join(map(repr, takers))}"
            )
    loads = (
        load_predictor, load_proposer, load_tracker, load_encoder, load_codes, load_lifting
    )  # fmt: skip
    for name, load in zip(takers, loads, strict=True):
        try:
            load(name, **settings.get(name, {}))
        except TypeError as error:
            raise InputError(f"settings of {name!r}: {error}") from None


def predict(
    sample: Sample, predictor: str, seed: int, settings: PartSettings, trust_cameras: bool = False
) -> Gaussians:
    """Gaussians from the context views (paper, section 3.1), once their cameras are believed.

    Raises
    ------
    InputError
        As :func:`slgaussian.cameras.check.check_cameras`, unless cameras are trusted, and as the
        predictor.
    """
    if not trust_cameras:
        check_cameras(sample)
    gaussians = load_predictor(predictor, **settings.get(predictor, {}))(sample, seed)
    opaque = _opaque(sample)
    if opaque is None:
        return gaussians
    return gaussians[torch.from_numpy(opaque.ravel()[gaussians.source.numpy()])]


def quality_of(sample: Sample, gaussians: Gaussians) -> Quality:
    """What the context views share and confirm of what was predicted from them."""
    cameras = [view.camera for view in sample.context]
    names = [view.name for view in sample.context]
    return measure(cameras, source_depths(gaussians, cameras), check_pairs(sample), names)


def label_views(
    sample: Sample,
    gaussians: Gaussians,
    proposer: str,
    tracker: str,
    replicas: int,
    settings: PartSettings,
) -> LabelMaps:
    """Object ids that agree across the context views (paper, section 3.2, Mask Association)."""
    depths = source_depths(gaussians, [view.camera for view in sample.context])
    maps = associate(
        sample.context,
        load_proposer(proposer, **settings.get(proposer, {})),
        load_tracker(tracker, **settings.get(tracker, {})),
        replicas,
        depths,
    )
    opaque = _opaque(sample)
    return maps if opaque is None else replace(maps, labels=np.where(opaque, maps.labels, 0))


def remember(
    sample: Sample,
    gaussians: Gaussians,
    label_maps: LabelMaps,
    encoder: str,
    codes: str,
    seed: int,
    settings: PartSettings | None = None,
) -> MemoryBank:
    """Draw an ID code for every object and encode what each view shows of it (section 3.2).

    Groups of objects are encoded too, as :func:`slgaussian.masks.levels.group_objects` finds them.
    With the encoder ``named`` objects get the vectors of their true names instead, and groups none.
    """
    settings = settings or {}
    strategy = load_codes(codes, **settings.get(codes, {}))
    drawn = strategy(label_maps, rng_for(seed, sample.content, "codes"))
    loaded = load_encoder(encoder, **settings.get(encoder, {}))
    names = true_names(sample, label_maps) if encoder == "named" else None
    cameras = [view.camera for view in sample.context]
    depths = source_depths(gaussians, cameras)
    room = find_room(cameras, depths)
    around = [room.place(camera, depth) for camera, depth in zip(cameras, depths, strict=True)]
    groups = group_objects(sample.context, label_maps, depths) if names is None else None
    return build_bank(sample.context, label_maps, loaded, drawn, names, around, groups)


def lift_field(
    sample: Sample,
    gaussians: Gaussians,
    label_maps: LabelMaps,
    bank: MemoryBank,
    lifting: str,
    settings: Mapping[str, Any],
    where: Mapping[str, str] | None = None,
    own: Mapping[str, Any] | None = None,
) -> SemanticField:
    """Join base Gaussians, labels and bank into a field (section 3.1, Semantic Parameters).

    ``where`` says where the encoder's files are; see :class:`slgaussian.field.SemanticField`.
    ``own`` are settings of the lifting, and ``settings`` what the field says of itself.
    """
    cameras = {view.name: view.camera for view in sample.context}
    lifted = load_lifting(lifting, **(own or {}))(gaussians, label_maps, bank)
    said = {**settings, "quality": quality_of(sample, gaussians).as_json()}
    return SemanticField(lifted, bank, cameras, said, where or {})


def _opaque(sample: Sample) -> np.ndarray | None:
    """Which pixels of the context show something, bool [V, H, W]; None if all do."""
    masks = [view.opaque for view in sample.context]
    if all(mask is None for mask in masks):
        return None
    full = np.ones(sample.context[0].image.shape[:2], bool)
    return np.stack([full if mask is None else mask for mask in masks])


def _with_defaults(encoder: str, settings: PartSettings) -> PartSettings:
    """A model is written down even where it is the one that the encoder has by default."""
    model = getattr(resolve("encoder", ENCODERS, encoder), "model", None)
    own = {} if model is None else {encoder: {"model": model, **settings.get(encoder, {})}}
    return {**settings, **own}
