"""The whole method, from two photographs to a field, as a few steps that can run on their own."""

import json
from collections.abc import Mapping
from typing import Any

from slgaussian.errors import InputError
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes, load_encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.masks import load_proposer, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.masks.precomputed import folder_digest
from slgaussian.predict import load_predictor
from slgaussian.pretrained import model_digest
from slgaussian.scene import Sample
from slgaussian.seeding import rng_for
from slgaussian.semantic import load_lifting
from slgaussian.store import sha256_of

PartSettings = Mapping[str, Mapping[str, Any]]
"""Settings of parts by the part's name, as in ``{"mvsplat": {"checkpoint": "re10k.ckpt"}}``."""

DIGESTS = {"checkpoint": sha256_of, "model": model_digest, "folder": folder_digest}
"""What stands for a setting of this name, a place, in artifacts and cache keys: its content."""


def build_field(
    sample: Sample,
    predictor: str = "planesweep",
    proposer: str = "regions",
    tracker: str = "geometric",
    encoder: str = "lexicon",
    codes: str = "grid",
    lifting: str = "hard",
    replicas: int = 5,
    seed: int = 0,
    settings: PartSettings | None = None,
) -> SemanticField:
    """From the context views of a sample to a field that answers words (paper, figure 2).

    Parameters
    ----------
    sample : Sample
        Its targets and truths are not looked at.
    predictor, proposer, tracker, encoder, codes, lifting : str
        The method of each part, by its name in the registry of its package.
    replicas : int
        How many copies of each view vote on its labels (five in the paper, section 3.2).
    seed : int
        Decides which ID codes are drawn; the same seed gives the same bytes.
    settings : mapping, optional
        Settings of the predictor, proposer and tracker, each under its name (see its class):
        ``{"mvsplat": {"checkpoint": "re10k.ckpt"}, "sam": {"model": "facebook/sam-vit-base"}}``.

    Returns
    -------
    SemanticField
        Its own ``settings`` say all this; see :func:`described`.

    Raises
    ------
    InputError
        If a name or a setting is unknown, a checkpoint does not fit, or the views cannot be used;
        the message says which and why.
    """
    settings = settings or {}
    check_parts(predictor, proposer, tracker, encoder, codes, lifting, settings)
    made_by = described(settings)
    gaussians = load_predictor(predictor, **settings.get(predictor, {}))(sample)
    label_maps = label_views(sample, gaussians, proposer, tracker, replicas, settings)
    bank = remember(sample, label_maps, encoder, codes, seed)
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
    return lift_field(sample, gaussians, label_maps, bank, lifting, about)


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
        If no part has one of these names, settings are of another part than the predictor,
        proposer or tracker, or files do not fit.
    """
    takers = predictor, proposer, tracker
    for name in settings:
        if name not in takers:
            raise InputError(
                f"settings: found some of {name!r}, expected none but those of the predictor, "
                f"proposer and tracker, which are {', '.join(map(repr, takers))}"
            )
    for name, load in zip(takers, (load_predictor, load_proposer, load_tracker), strict=True):
        try:
            load(name, **settings.get(name, {}))
        except TypeError as error:
            raise InputError(f"settings of {name!r}: {error}") from None
    load_encoder(encoder)
    load_codes(codes)
    load_lifting(lifting)


def described(settings: PartSettings) -> dict[str, dict[str, Any]]:
    """Settings of parts as artifacts and cache keys hold them: files by content, not by place.

    That is, of a setting called ``checkpoint`` the SHA-256 of the file, hexadecimal; see
    :data:`DIGESTS`.

    Raises
    ------
    InputError
        If a value cannot be written down.
    """
    found = {
        part: {
            name: DIGESTS[name](value) if name in DIGESTS else value for name, value in own.items()
        }
        for part, own in settings.items()
    }
    try:
        json.dumps(found)
    except TypeError as error:
        raise InputError(f"settings: {error}; give plain numbers and text") from None
    return found


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
    return associate(
        sample.context,
        load_proposer(proposer, **settings.get(proposer, {})),
        load_tracker(tracker, **settings.get(tracker, {})),
        replicas,
        depths,
    )


def remember(
    sample: Sample, label_maps: LabelMaps, encoder: str, codes: str, seed: int
) -> MemoryBank:
    """Draw an ID code for every object and encode what each view shows of it (section 3.2)."""
    drawn = load_codes(codes)(len(label_maps.ids), rng_for(seed, sample.scene, "codes"))
    return build_bank(sample.context, label_maps, load_encoder(encoder), drawn)


def lift_field(
    sample: Sample,
    gaussians: Gaussians,
    label_maps: LabelMaps,
    bank: MemoryBank,
    lifting: str,
    settings: Mapping[str, Any],
) -> SemanticField:
    """Join base Gaussians, labels and bank into a field (section 3.1, Semantic Parameters)."""
    cameras = {view.name: view.camera for view in sample.context}
    lifted = load_lifting(lifting)(gaussians, label_maps, bank)
    return SemanticField(lifted, bank, cameras, settings)
