"""Words for the objects of a procedural room, and the materials that they denote."""

from __future__ import annotations

import numpy as np

from slgaussian.datasets.procedural import textures
from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, RING
from slgaussian.datasets.procedural.textures import RGB, Material
from slgaussian.formats.colour import decode_srgb

COLOURS = {
    "red": (0.76, 0.12, 0.13),
    "orange": (0.94, 0.48, 0.08),
    "yellow": (0.95, 0.80, 0.16),
    "green": (0.15, 0.55, 0.24),
    "blue": (0.13, 0.30, 0.73),
    "purple": (0.46, 0.20, 0.62),
    "pink": (0.94, 0.56, 0.70),
    "brown": (0.42, 0.25, 0.14),
    "black": (0.11, 0.11, 0.12),
    "white": (0.92, 0.92, 0.90),
    "grey": (0.52, 0.52, 0.53),
    "beige": (0.83, 0.74, 0.58),
}
"""Basic colour names, each with the sRGB colour that is jittered for an object."""

PATTERNS = ("striped", "checked", "dotted", "speckled")
"""Patterns in two colours, named after the main one."""

MATERIALS = ("wooden", "marble", "brick", "gravel", "grass")
"""Materials that replace the colour in a name."""

SHAPES = {"ball": BALL, "box": BOX, "cylinder": CYLINDER, "cone": CONE, "ring": RING}
STUFF = ("floor", "wall", "ceiling", "carpet", "table", "picture")

VOCABULARY = frozenset((*COLOURS, *PATTERNS, *MATERIALS, *SHAPES, *STUFF))
"""Every word that a phrase can contain."""

# Dominant colour of a material: a room must not have both a "brown box" and a "wooden box".
_LOOKS = {"wooden": "brown", "marble": "white", "brick": "red", "gravel": "grey", "grass": "green"}
_PAINTS = {
    "wooden": (textures.WOODEN, (0.66, 0.43, 0.24), (0.47, 0.28, 0.14), 0.0, 0.06),
    "marble": (textures.MARBLE, (0.9, 0.9, 0.89), (0.5, 0.52, 0.56), 0.35, 0.05),
    "brick": (textures.BRICK, (0.62, 0.27, 0.2), (0.72, 0.69, 0.65), 0.08, 0.0),
}  # pattern, two sRGB colours, constant cell size if any, gloss
_TINTS = {"gravel": (0.56, 0.55, 0.53), "grass": (0.35, 0.52, 0.20)}


def material(rng: np.random.Generator, words: str, cell: float) -> Material:
    """Make the material of ``words``: a colour, a colour and a pattern, or a material."""
    colour, _, pattern = words.partition(" ")
    if colour in _PAINTS:
        kind, light, dark, size, gloss = _PAINTS[colour]
        return Material(kind, jitter(rng, light), jitter(rng, dark), size or cell, gloss=gloss)
    if colour in _TINTS:
        tint = jitter(rng, _TINTS[colour])
        return Material(textures.PHOTO, tint, cell=max(cell, 0.9), photo=colour, gloss=0.0)
    if colour == "checked":  # of a floor: black and white tiles
        black, white = jitter(rng, (0.2, 0.2, 0.21)), jitter(rng, COLOURS["white"])
        return Material(textures.CHECKED, white, black, cell, gloss=0.1)
    second = "white" if colour not in ("white", "beige", "yellow", "grey") else "black"
    return Material(
        pattern=getattr(textures, pattern.upper()) if pattern else textures.PLAIN,
        first=jitter(rng, COLOURS[colour]),
        second=jitter(rng, COLOURS[second]),
        cell=0.03 if pattern == "speckled" else cell,
        gloss=float(rng.choice([0.02, 0.12, 0.3])),
    )


def jitter(rng: np.random.Generator, srgb: RGB) -> RGB:
    """Return a linear colour near an sRGB colour, with random lightness and hue."""
    values = np.clip(np.array(srgb) * rng.uniform(0.94, 1.05) + rng.normal(0, 0.008, 3), 0.02, 0.97)
    r, g, b = decode_srgb(values).tolist()
    return r, g, b


def look(words: str) -> str:
    """Return the basic colour of ``words``, to keep objects distinguishable."""
    first = words.split(" ")[0]
    return _LOOKS.get(first, first)
