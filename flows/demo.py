"""The scenes of `slgaussian demo`: what every installation has."""

from flows.settings import SceneSettings

ROOMS = (0, 1, 2)
"""Seeds of the procedural rooms."""


def demo_scenes() -> list[SceneSettings]:
    """The motorcycle stereo pair at its own size and three procedural rooms with novel views."""
    motorcycle = SceneSettings(
        name="motorcycle",
        format="stereo",
        context=["left", "right"],
        size="original",
        queries=["red", "black", "brown wood", "grey metal", "white wall", "grey floor"],
    )
    rooms = [
        SceneSettings(
            name=f"room_{seed}",
            format="procedural",
            options={"seed": seed, "objects": 8, "views": 4},
            context=["view_00", "view_03"],
            targets=["view_01", "view_02"],
        )
        for seed in ROOMS
    ]
    return [motorcycle, *rooms]
