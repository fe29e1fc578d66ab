"""Which published scene some labels are of, by what is in them: a folder's name says nothing.

Scenes of LERF-OVS and 3D-OVS are known by the numbers of their labelled frames, the size of those
photographs and the texts that are labelled there, as far as public sources say: see
:data:`slgaussian.datasets.lerf_ovs.PUBLISHED` and :data:`slgaussian.datasets.ovs3d.PUBLISHED`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from slgaussian.datasets import lerf_ovs, ovs3d
from slgaussian.datasets.labelled_scene import LabelledScene

SETS: dict[str, dict[str, LabelledScene]] = {
    "lerf_ovs": lerf_ovs.PUBLISHED,
    "ovs3d": ovs3d.PUBLISHED,
}
"""The published scenes by the format of their data and by name."""

SHARE = 0.75
"""Of the texts that are labelled, how many must be published ones: lists of texts were published
apart from the labels, and a few may be missing or written differently."""

RECOGNISED, UNVERIFIED, ANOTHER = "recognised", "unverified", "another"


@dataclass(frozen=True)
class Found:
    """What is there of a scene that was asked.

    Attributes
    ----------
    format, name : str
        Of its data, and what they call it: its folder's name.
    asked : {frame: texts}
        The labelled frames that it was asked in, without an extension, and what is labelled there.
    frames : sequence of str
        All frames that have labels.
    sizes : {frame: (width, height)}
        Pixels of the photographs of frames that were asked, of those that can be opened.
    """

    format: str
    name: str
    asked: Mapping[str, Sequence[str]]
    frames: Sequence[str] = ()
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Standing:
    """Whether a scene is a published one.

    Attributes
    ----------
    standing : str
        :data:`RECOGNISED`; :data:`UNVERIFIED` where all agrees that is published, but what is
        labelled is not; or :data:`ANOTHER`: called like a published scene, and not that.
    format, scene : str
        The published scene.
    why : str
        Of another one: what was found, and what expected.
    """

    standing: str
    format: str
    scene: str
    why: str = ""


def standing(found: Found) -> Standing | None:
    """Which published scene this is, or is called like and is not; None if neither.

    Any folder may hold a published scene. Where its texts are not published, it must have the
    scene's name and all of its labelled frames.
    """
    for format, scenes in SETS.items():
        for name, scene in scenes.items():
            if scene.texts and not _differs(found, scene):
                return Standing(RECOGNISED, format, name)
    named = SETS.get(found.format, {}).get(found.name)
    if named is None:
        return None
    why = _differs(found, named)
    return Standing(ANOTHER if why else UNVERIFIED, found.format, found.name, why)


def _differs(found: Found, scene: LabelledScene) -> str:
    """The first thing that differs from a published scene; empty if nothing does."""
    strange = [frame for frame in found.asked if frame not in scene.frames]
    if not found.asked or strange:
        return f"found labelled frames {_some(strange) or 'none'}, expected {_some(scene.frames)}"
    if not scene.texts and set(found.frames) != set(scene.frames):
        return f"found labelled frames {_some(found.frames)}, expected {_some(scene.frames)}"
    if scene.texts:
        texts = list(dict.fromkeys(text.casefold() for own in found.asked.values() for text in own))
        known = {text.casefold() for text in scene.texts}
        strange = [text for text in texts if text not in known]
        if not texts or len(strange) > (1 - SHARE) * len(texts):
            return f"found labels of {_some(strange) or 'nothing'}, expected {_some(scene.texts)}"
    if scene.size is not None:
        for frame in found.asked:
            if found.sizes.get(frame) != scene.size:
                has = "x".join(map(str, found.sizes.get(frame, ()))) or "no size"
                return f"found {frame} of {has} pixels, expected {'x'.join(map(str, scene.size))}"
    return ""


def _some(names: Sequence[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (" ..." if len(names) > most else "")
