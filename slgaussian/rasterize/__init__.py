"""Rasterization of Gaussians: one public function, several equivalent backends."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from slgaussian.rasterize.api import BACKENDS, Render, rasterize
from slgaussian.rasterize.render_settings import PRESETS, Settings

if TYPE_CHECKING:
    from slgaussian.rasterize.planned import SplatPlan, plan

__all__ = [
    "BACKENDS",
    "PRESETS",
    "Render",
    "Settings",
    "SplatPlan",
    "plan",
    "rasterize",
]

# Loaded on first use: drawing a field needs neither torch nor their kernels.
_LATER = {
    "SplatPlan": "slgaussian.rasterize.planned",
    "plan": "slgaussian.rasterize.planned",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module 'slgaussian.rasterize' has no attribute {name!r}")


class _CallablePackage(ModuleType):
    # Importing any part of this package makes ``slgaussian.rasterize`` the package, where the
    # public name is that of the function.
    __call__ = staticmethod(rasterize)


sys.modules[__name__].__class__ = _CallablePackage
