"""Splat Gaussians onto an image: one public call, several backends with one meaning."""

import sys
from types import ModuleType

from slgaussian.rasterize.api import BACKENDS, Render, rasterize
from slgaussian.rasterize.planned import SplatPlan, plan
from slgaussian.rasterize.pruning import Pruned, prune
from slgaussian.rasterize.render_settings import PRESETS, Settings

__all__ = [
    "BACKENDS",
    "PRESETS",
    "Pruned",
    "Render",
    "Settings",
    "SplatPlan",
    "plan",
    "prune",
    "rasterize",
]


class _CallablePackage(ModuleType):
    # Importing any part of this package makes ``slgaussian.rasterize`` the package, where the
    # public name is that of the function.
    __call__ = staticmethod(rasterize)


sys.modules[__name__].__class__ = _CallablePackage
