"""SLGaussian: two photographs in, a 3D scene of Gaussians that answers words out.

>>> import slgaussian as slg
>>> sample = slg.photographs("a.jpg", "b.jpg")
>>> field = slg.build_field(sample)
>>> hit = field.render(sample.context[0].camera).query("red")
"""

from importlib import import_module
from typing import Any

import slgaussian.kernels.threads  # noqa: F401  (configures thread pools before they start)

__version__ = "0.1.0"

# Imported on first use, so that `slgaussian --help` does not import torch.
_PUBLIC = {
    "Camera": "slgaussian.scene",
    "View": "slgaussian.scene",
    "Scene": "slgaussian.scene",
    "Sample": "slgaussian.scene",
    "Gaussians": "slgaussian.gaussians",
    "LabelMaps": "slgaussian.labels",
    "MemoryBank": "slgaussian.language.bank",
    "SemanticField": "slgaussian.field",
    "photographs": "slgaussian.datasets.unposed",
    "build_field": "slgaussian.build",
    "Method": "slgaussian.components.method",
    "rasterize": "slgaussian.rasterize",
    "load_ply": "slgaussian.formats.ply",
    "save_ply": "slgaussian.formats.ply",
    "load_predictor": "slgaussian.predict",
    "InputError": "slgaussian.errors",
    "SpecError": "slgaussian.errors",
    "SLGaussianError": "slgaussian.errors",
}
_MODULES = {
    "benchmark", "cameras", "datasets", "language", "masks", "predict", "semantic", "storage",
}  # fmt: skip

__all__ = sorted([*_PUBLIC, *_MODULES, "__version__"])


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    if name in _MODULES:
        return import_module(f"slgaussian.{name}")
    raise AttributeError(f"module 'slgaussian' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
