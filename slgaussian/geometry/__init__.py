"""What is seen of a scene: depth, borders and the room, each derived once and read by many."""

from slgaussian.geometry.seen import SceneGeometry, SeenView

__all__ = ["SceneGeometry", "SeenView"]
