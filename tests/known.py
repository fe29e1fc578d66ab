"""Fields of known Gaussians and label maps, for tests of later stages."""

from slgaussian.build import build_memory_bank, lift_field
from slgaussian.cameras.quality import Quality
from slgaussian.components.method import Method
from slgaussian.field import SemanticField
from slgaussian.gaussians import Gaussians
from slgaussian.geometry import SceneGeometry
from slgaussian.labels import LabelMaps
from slgaussian.language.bank import MemoryBank
from slgaussian.scene import Sample

QUALITY = Quality(0.7, 0.6, 12.0, 15.0, 200, 0.9, 7.1, True)


def known_bank(
    sample: Sample, gaussians: Gaussians, labels: LabelMaps, method: Method
) -> MemoryBank:
    """Build the memory bank of the objects of label maps."""
    geometry = SceneGeometry.of(sample.context, gaussians)
    encoder, codes = method.encoder.load(), method.codes.load()
    return build_memory_bank(sample, geometry, labels, encoder, codes, method.seed)


def known_field(
    sample: Sample,
    gaussians: Gaussians,
    labels: LabelMaps,
    method: Method | None = None,
    bank: MemoryBank | None = None,
) -> SemanticField:
    """Build a field of Gaussians and label maps; without a method, of all Gaussians."""
    method = method or Method(keep="all")
    bank = bank or known_bank(sample, gaussians, labels, method)
    return lift_field(sample, gaussians, labels, bank, method.lifting.load(), method, QUALITY)
