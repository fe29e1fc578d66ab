"""Seeded small rooms: objects with positions, materials and phrases."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slgaussian.datasets.procedural import raycast, textures
from slgaussian.datasets.procedural.raycast import BALL, BOX, CONE, CYLINDER, RING, Solid
from slgaussian.datasets.procedural.shading import Light
from slgaussian.datasets.procedural.textures import RGB, Material
from slgaussian.errors import InputError
from slgaussian.formats.colour import decode_srgb
from slgaussian.scene import Camera

MAX_OBJECTS = 16

_FLOORS = ("wooden", "wooden", "grey", "beige", "marble", "gravel", "checked", "grey speckled")
_WALLS = ("white", "grey", "beige", "yellow", "green", "blue", "pink", "brick")

_WIDTH, _BACK, _FRONT, _HEIGHT = 2.3, 1.7, -4.2, 2.7  # half width, y of the walls, height (metres)
_STAGE = (1.55, -1.05, 1.25)  # objects stand in |x| < .., y between
_GAP = 0.04
_CARPET_THICKNESS = 0.012
_MIN_VISIBLE_SHARE = 0.0035  # smallest fraction of each end view that an object must fill

FOCUS = np.array([0.0, 0.15, 0.45])  # the point at which the cameras look

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


@dataclass(frozen=True, eq=False)
class Thing:
    """One object: its phrase, its material and its solids."""

    phrase: str
    material: Material
    solids: tuple[Solid, ...]


@dataclass(frozen=True, eq=False)
class Room:
    """Objects of a room, walls, floor and ceiling first, and its lamp. z is up, units are metres.

    The id of an object is its index in ``things`` plus 1.
    """

    things: tuple[Thing, ...]
    light: Light

    def solids(self, casters: bool = False) -> raycast.Solids:
        """Pack all solids; with ``casters`` without walls, floor and ceiling (no shadows)."""
        return raycast.pack([s for t in self.things for s in t.solids][6 if casters else 0 :])

    def materials(self, rng: np.random.Generator) -> textures.Materials:
        """Pack a material for each solid, in their order."""
        return textures.pack([t.material for t in self.things for _ in t.solids], rng)

    def owners(self) -> np.ndarray:
        """Return the object id of each solid, int32 [P]."""
        ids = np.arange(1, len(self.things) + 1, dtype=np.int32)
        return np.repeat(ids, [len(thing.solids) for thing in self.things])


def furnish(rng: np.random.Generator, objects: int, cameras: Sequence[Camera]) -> Room:
    """Furnish a room with ``objects`` free-standing objects, each visible in all ``cameras``.

    Raises:
        InputError: If the objects cannot be placed.
    """
    for _ in range(20):
        room = _attempt(rng, objects, cameras)
        if room is not None:
            return room
    raise InputError(
        f"procedural scene: found no arrangement of {objects} objects visible in all cameras; "
        "set fewer objects, or a smaller baseline"
    )


def _attempt(rng: np.random.Generator, objects: int, cameras: Sequence[Camera]) -> Room | None:
    used_looks: set[tuple[str, str]] = set()
    things = _shell(rng, used_looks)
    ground = _Ground()
    if rng.random() < 0.75:
        things.append(_carpet(rng, ground, things[0], used_looks))
    if rng.random() < 0.75:
        things.append(_table(rng, ground, used_looks))
    if rng.random() < 0.8:
        things.append(_picture(rng))
    fixed = len(things)
    for _ in range(30 * objects):
        if len(things) - fixed == objects:
            break
        candidate = _object(rng, ground, used_looks)
        if candidate is None:
            continue
        thing, key, place, circle, top = candidate
        if _all_visible([*things, thing], fixed, cameras):
            things.append(thing)
            used_looks.add(key)
            place.circles.append(circle)
            ground.tops += [] if top is None else [top]
    if len(things) - fixed < objects:
        return None
    light = Light(
        centre=np.array([rng.choice([-1, 1]) * rng.uniform(0.6, 1.6), rng.uniform(-1.6, 0.0), 2.5]),
        half=0.22,
        power=rng.uniform(0.78, 0.9),
        reach=2.4,
        ambient=rng.uniform(0.34, 0.4),
    )
    return Room(tuple(things), light)


def _all_visible(things: Sequence[Thing], fixed: int, cameras: Sequence[Camera]) -> bool:
    """Tell whether all objects after the first ``fixed`` are large enough in every image."""
    room = Room(tuple(things), Light(np.zeros(3), 0, 0, 1, 0))
    owners, solids = room.owners(), room.solids()
    for camera in cameras:
        _, index = raycast.cast(solids, camera.center, camera.rays())
        fraction = np.bincount(owners[index].ravel(), minlength=len(things) + 1) / index.size
        if (fraction[fixed + 1 :] < _MIN_VISIBLE_SHARE).any():
            return False
    return True


def _desaturate(material: Material) -> Material:
    """Desaturate a material for walls, whose large areas would otherwise dominate the image."""
    if material.pattern == textures.BRICK:
        return material
    r, g, b = (0.88 * value + 0.12 * 0.8 for value in material.first)
    return replace(material, first=(r, g, b), gloss=0.0)


def _shell(rng: np.random.Generator, used_looks: set[tuple[str, str]]) -> list[Thing]:
    """Make floor, ceiling, back wall and, as one object, side walls and the wall behind cameras."""
    floor, back = str(rng.choice(_FLOORS)), str(rng.choice(_WALLS))
    side = str(rng.choice([w for w in _WALLS if find_look(w) != find_look(back) and w != "brick"]))
    middle, depth, half, t = (_BACK + _FRONT) / 2, (_BACK - _FRONT) / 2, _HEIGHT / 2, 0.1
    surfaces = ("floor", floor), ("wall", back), ("wall", side)
    used_looks.update((surface, find_look(words)) for surface, words in surfaces)
    below = Solid(BOX, (_WIDTH, depth, t), (0, middle, -t))
    above = Solid(BOX, (_WIDTH, depth, t), (0, middle, _HEIGHT + t))
    ends = [Solid(BOX, (_WIDTH, t, half), (0, y, half)) for y in (_BACK + t, _FRONT - t)]
    sides = [Solid(BOX, (t, depth, half), (x, middle, half)) for x in (-_WIDTH - t, _WIDTH + t)]
    tiles = make_material(rng, floor, 0.35 if floor == "checked" else 0.16)
    return [
        Thing(f"{floor} floor", replace(tiles, gloss=0.03), (below,)),
        Thing("white ceiling", make_material(rng, "white", 1.0), (above,)),
        Thing(f"{back} wall", _desaturate(make_material(rng, back, 0.9)), (ends[0],)),
        Thing(f"{side} wall", _desaturate(make_material(rng, side, 0.9)), (*sides, ends[1])),
    ]


@dataclass(frozen=True, eq=False)
class _Place:
    """A horizontal rectangle for objects: pose, half sides and occupied circles (x, y, radius)."""

    centre: tuple[float, float]
    angle: float
    half: tuple[float, float]
    z: float
    circles: list[tuple[float, float, float]]

    def distance(self, x: float, y: float) -> float:
        """Return the signed distance from a point to the rectangle's edge, negative inside."""
        dx, dy = x - self.centre[0], y - self.centre[1]
        c, s = math.cos(self.angle), math.sin(self.angle)
        qx, qy = abs(c * dx + s * dy) - self.half[0], abs(c * dy - s * dx) - self.half[1]
        return math.hypot(max(qx, 0), max(qy, 0)) + min(max(qx, qy), 0)


class _Ground:
    """Surfaces for objects: the floor, the carpet, the tops of a table and of boxes."""

    def __init__(self) -> None:
        x, y0, y1 = _STAGE
        self.floor = _Place((0, (y0 + y1) / 2), 0.0, (x, (y1 - y0) / 2), 0.0, [])
        self.carpet: _Place | None = None
        self.table: _Place | None = None
        self.tops: list[_Place] = []

    def find(self, rng: np.random.Generator, radius: float) -> tuple[float, float, _Place] | None:
        """Find a free position for a circle on a random surface."""
        raised = [p for p in self.tops if not p.circles and min(p.half) > radius]
        if self.table is not None and min(self.table.half) > radius:
            raised.append(self.table)
        place = self.floor
        if raised and rng.random() < 0.4:
            place = raised[rng.integers(len(raised))]
        u, v = (rng.uniform(-1, 1, 2) * (np.array(place.half) - radius)).tolist()
        c, s = math.cos(place.angle), math.sin(place.angle)
        x, y = place.centre[0] + c * u - s * v, place.centre[1] + s * u + c * v
        if place is self.floor:
            if self.table is not None and self.table.distance(x, y) < radius + _GAP:
                return None
            if self.carpet is not None:
                edge = self.carpet.distance(x, y)
                if abs(edge) < radius + 0.005:
                    return None
                # The carpet shares the circles of the floor: it only raises objects on it.
                place = self.carpet if edge < 0 else self.floor
        occupied = any(math.hypot(x - a, y - b) < r + radius + _GAP for a, b, r in place.circles)
        return None if occupied else (x, y, place)


def _carpet(
    rng: np.random.Generator, ground: _Ground, floor: Thing, used_looks: set[tuple[str, str]]
) -> Thing:
    below = find_look(floor.phrase)
    colours = [c for c in ("red", "blue", "green", "purple", "orange", "beige") if c != below]
    words = str(rng.choice(colours))
    if rng.random() < 0.4:
        words += " " + str(rng.choice(["striped", "checked", "dotted"]))
    elif rng.random() < 0.15 and below != "green":
        words = "grass"
    a, b, x, y, angle = rng.uniform(
        (0.75, 0.5, -0.35, -0.4, -0.2), (1.05, 0.7, 0.35, -0.2, 0.2)
    ).tolist()
    ground.carpet = _Place((x, y), angle, (a, b), _CARPET_THICKNESS, ground.floor.circles)
    solid = Solid(
        BOX, (a, b, _CARPET_THICKNESS / 2), (x, y, _CARPET_THICKNESS / 2), _rotate_z(angle)
    )
    used_looks.add(("carpet", find_look(words)))
    return Thing(f"{words} carpet", replace(make_material(rng, words, 0.16), gloss=0.0), (solid,))


def _table(rng: np.random.Generator, ground: _Ground, used_looks: set[tuple[str, str]]) -> Thing:
    words = str(rng.choice(["wooden", "wooden", "white", "black", "brown"]))
    a, b, height = rng.uniform((0.45, 0.28, 0.42), (0.6, 0.36, 0.6)).tolist()
    top, leg = 0.025, 0.03
    side = float(rng.choice([-1, 1]))
    angle = float(rng.uniform(-0.15, 0.15))
    # The table stands at the wall, so its front edge is behind any carpet.
    deep = a * abs(math.sin(angle)) + b * math.cos(angle)
    x, y = side * float(rng.uniform(0.75, 1.1)), _BACK - 0.06 - deep
    turn, reach = _rotate_z(angle), (height - 2 * top) / 2
    solids = [Solid(BOX, (a, b, top), (x, y, height - top), turn)]
    for sx, sy in itertools.product((-1, 1), (-1, 1)):
        dx, dy, _ = (turn @ [sx * (a - 2 * leg), sy * (b - 2 * leg), 0]).tolist()
        solids.append(Solid(BOX, (leg, leg, reach), (x + dx, y + dy, reach), turn))
    ground.table = _Place((x, y), angle, (a, b), height, [])
    used_looks.add(("table", find_look(words)))
    return Thing(f"{words} table", make_material(rng, words, 0.4), tuple(solids))


def _picture(rng: np.random.Generator) -> Thing:
    half = float(rng.uniform(0.26, 0.36))
    frame = jitter(rng, COLOURS[str(rng.choice(["black", "white", "brown"]))])
    photo = str(rng.choice(textures.PHOTOS[2:]))
    x, z = rng.uniform((-1.0, 1.35), (1.0, 1.5)).tolist()
    material = Material(textures.PICTURE, frame, frame, photo=photo, gloss=0.02)
    return Thing("picture", material, (Solid(BOX, (half, 0.015, half), (x, _BACK - 0.015, z)),))


def _object(
    rng: np.random.Generator, ground: _Ground, used_looks: set[tuple[str, str]]
) -> tuple[Thing, tuple[str, str], _Place, tuple[float, float, float], _Place | None] | None:
    """Make an object of an unused combination of look and shape, at a free position if any.

    Returns the object, its shape and look, its surface and circle, and its top.
    """
    shape = str(rng.choice(list(SHAPES)))
    draw = rng.random()
    if draw < 0.2 and shape in ("box", "cylinder"):
        words = str(rng.choice([m for m in MATERIALS if (shape, m) != ("cylinder", "brick")]))
    else:
        words = str(rng.choice(list(COLOURS)))
        if draw > 0.55:
            words += " " + str(rng.choice(PATTERNS))
    key = shape, find_look(words)
    if key in used_looks:
        return None
    scale = float(rng.uniform(0.15, 0.31))
    spot = ground.find(rng, scale * 1.02)
    if spot is None:
        return None
    x, y, place = spot
    angle, top = float(rng.uniform(0, 2 * math.pi)), None
    turn = _rotate_z(angle)
    size: Sequence[float]
    if shape == "ball":
        size, lift, turn = (scale,), scale, np.eye(3)
    elif shape == "box":
        a, b = (scale * math.sqrt(0.5) * rng.uniform([0.85, 0.85], [1, 1])).tolist()
        lift = scale * float(rng.uniform(0.6, 1.5))
        size = a, b, lift
        if lift < 1.1 * scale:
            top = _Place((x, y), angle, (a, b), place.z + 2 * lift, [])
    elif shape in ("cylinder", "cone"):
        low, high = ((0.6, 0.7), (0.9, 1.6)) if shape == "cylinder" else ((0.75, 0.9), (1.0, 1.6))
        size = (scale * rng.uniform(low, high)).tolist()
        lift = size[1]
    else:
        tube = scale * float(rng.uniform(0.2, 0.28))
        size, lift = (scale - tube, tube), tube
        if rng.random() >= 0.5:  # standing, its axis level and roughly towards the cameras
            turn, lift = _rotate_z(float(rng.uniform(-0.7, 0.7))) @ _QUARTER_TURN, scale
    solid = Solid(SHAPES[shape], tuple(size), (x, y, place.z + lift), turn)
    cell = {"striped": 0.3, "checked": 0.38, "dotted": 0.42}.get(words.split(" ")[-1], 1.0) * scale
    thing = Thing(f"{words} {shape}", make_material(rng, words, cell), (solid,))
    return thing, key, place, (x, y, scale), top


_QUARTER_TURN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # rotates local z to -y


def _rotate_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def make_material(rng: np.random.Generator, words: str, cell: float) -> Material:
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


def find_look(words: str) -> str:
    """Return the basic colour of ``words``, to keep objects distinguishable."""
    first = words.split(" ")[0]
    return _LOOKS.get(first, first)
