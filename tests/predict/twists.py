"""Procedural rooms seen from an arc, and a photograph of another one."""

from dataclasses import replace

from slgaussian import datasets
from slgaussian.scene import Sample, View


def arc(seed: int, number: int, size: tuple[int, int]) -> Sample:
    """Render a room from ``number`` places of an arc of 1 m; a target is in every second gap."""
    height, width = size
    shape = {"baseline": 1.0, "height": height, "width": width}
    scene = datasets.load("procedural", seed, views=2 * number - 1, **shape)
    names = list(scene.cameras)
    return scene.sample(names[::2], names[1::4])


def stranger(seed: int, inputs: Sample, place: int) -> View:
    """Render another room from a camera between two of this room."""
    a, b = (view.camera for view in inputs.context[place : place + 2])
    other = arc(seed + 1000, len(inputs.context), (a.height, a.width)).context[place]
    between = a.c2w.copy()
    between[:3, 3] = (2 * a.center + b.center) / 3
    camera = replace(a, c2w=between)
    return replace(other, name="stranger", camera=camera, depth=None, instances=None)
