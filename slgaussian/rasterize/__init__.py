"""Rasterization of Gaussians: one public function, several equivalent backends."""

import sys
from types import ModuleType

from slgaussian.rasterize.api import BACKENDS, Render, rasterize
from slgaussian.rasterize.render_settings import PRESETS, Settings

__all__ = ["BACKENDS", "PRESETS", "Render", "Settings", "rasterize"]


class _CallablePackage(ModuleType):
    # Importing any part of this package makes ``slgaussian.rasterize`` the package, where the
    # public name is that of the function.
    __call__ = staticmethod(rasterize)


sys.modules[__name__].__class__ = _CallablePackage
