"""Geometry of a scene from its Gaussians: depth, boundaries and the room, each computed once."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # loaded on first use: a field's bank needs only the room, and no kernels
    from slgaussian.geometry.seen import SceneGeometry, SeenView

__all__ = ["SceneGeometry", "SeenView"]


if not TYPE_CHECKING:  # which would find every name in a module with this function

    def __getattr__(name: str) -> Any:
        if name in __all__:
            return getattr(import_module("slgaussian.geometry.seen"), name)
        raise AttributeError(f"module 'slgaussian.geometry' has no attribute {name!r}")
