"""The scenes of `slgaussian demo`: what every installation has."""

from flows.room_scenes import room_scene
from flows.settings import SceneSettings

ROOMS = (0, 1, 2)
"""Seeds of the procedural rooms."""


def demo_scenes() -> list[SceneSettings]:
    """The motorcycle stereo pair at its own size and three procedural rooms with novel views."""
    motorcycle = SceneSettings(
        name="motorcycle",
        dataset="stereo",
        format="stereo",
        context=["left", "right"],
        size="original",
        queries=["red", "black", "brown wood", "grey metal", "white wall", "grey floor"],
    )
    return [motorcycle, *map(room_scene, ROOMS)]
