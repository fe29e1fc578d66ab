"""The whole method, from two photographs to a field, as a few steps that can run on their own."""

from collections.abc import Mapping
from typing import Any

from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians, source_depths
from slgaussian.labels import LabelMaps
from slgaussian.language import load_codes, load_encoder
from slgaussian.language.bank import MemoryBank, build_bank
from slgaussian.masks import load_proposer, load_tracker
from slgaussian.masks.associate import associate
from slgaussian.predict import load_predictor
from slgaussian.scene import Sample
from slgaussian.seeding import rng_for
from slgaussian.semantic import load_lifting


def build_field(
    sample: Sample,
    predictor: str = "planesweep",
    proposer: str = "regions",
    tracker: str = "flow",
    encoder: str = "lexicon",
    codes: str = "grid",
    lifting: str = "hard",
    replicas: int = 5,
    seed: int = 0,
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

    Raises
    ------
    InputError
        If a name is unknown or the views cannot be used; the message says which and why.
    """
    check_parts(predictor, proposer, tracker, encoder, codes, lifting)
    gaussians = load_predictor(predictor)(sample)
    label_maps = label_views(sample, gaussians, proposer, tracker, replicas)
    bank = remember(sample, label_maps, encoder, codes, seed)
    settings = {
        "scene": sample.scene,
        "predictor": predictor,
        "proposer": proposer,
        "tracker": tracker,
        "encoder": encoder,
        "codes": codes,
        "lifting": lifting,
        "replicas": replicas,
        "seed": seed,
    }
    return lift_field(sample, gaussians, label_maps, bank, lifting, settings)


def check_parts(
    predictor: str, proposer: str, tracker: str, encoder: str, codes: str, lifting: str
) -> None:
    """Raise InputError if no part has one of these names, before the others have worked."""
    load_predictor(predictor)
    load_proposer(proposer)
    load_tracker(tracker)
    load_encoder(encoder)
    load_codes(codes)
    load_lifting(lifting)


def label_views(
    sample: Sample, gaussians: Gaussians, proposer: str, tracker: str, replicas: int
) -> LabelMaps:
    """Object ids that agree across the context views (paper, section 3.2, Mask Association)."""
    depths = source_depths(gaussians, [view.camera for view in sample.context])
    return associate(
        sample.context, load_proposer(proposer), load_tracker(tracker), replicas, depths
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
