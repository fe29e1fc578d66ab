"""The published scenes of LERF-OVS and 3D-OVS, known by their content and not by their folders.

Known by their labelled frames, the size of those photographs and the texts that are labelled there,
as far as public sources say (``published.toml``).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files


@dataclass(frozen=True)
class LabelledScene:
    """A published scene.

    Attributes
    ----------
    frames : tuple of str
        Its labelled frames, without an extension.
    texts : tuple of str
        What is labelled there; empty where no public source says it.
    size : (width, height), optional
        Pixels of its photographs, where a public source says it.
    """

    frames: tuple[str, ...]
    texts: tuple[str, ...] = ()
    size: tuple[int, int] | None = None


SETS: dict[str, dict[str, LabelledScene]] = {
    format: {
        name: LabelledScene(**{key: tuple(values) for key, values in scene.items()})
        for name, scene in scenes.items()
    }
    for format, scenes in tomllib.loads(
        (files("slgaussian.datasets") / "published.toml").read_text("utf-8")
    ).items()
}
"""The published scenes by the format of their data and by name."""

SHARE = 0.75
"""Of the texts that are labelled, how many must be published ones: lists of texts were published
apart from the labels, and a few may be missing or written differently."""

RECOGNISED, UNVERIFIED, ANOTHER = "recognised", "unverified", "another"


@dataclass(frozen=True)
class LabelledFrames:
    """A scene that was asked.

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
    """Relation of a scene to the published ones.

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


def standing(labelled: LabelledFrames) -> Standing | None:
    """Return the published scene that this is, or is called like and is not; None if neither.

    Any folder may hold a published scene. Where its texts are not published, it must have the
    scene's name and all of its labelled frames.
    """
    for format, scenes in SETS.items():
        for name, scene in scenes.items():
            if scene.texts and not _differs(labelled, scene):
                return Standing(RECOGNISED, format, name)
    named = SETS.get(labelled.format, {}).get(labelled.name)
    if named is None:
        return None
    why = _differs(labelled, named)
    return Standing(ANOTHER if why else UNVERIFIED, labelled.format, labelled.name, why)


def _differs(labelled: LabelledFrames, scene: LabelledScene) -> str:
    """Return the first thing that differs from a published scene; empty if nothing does."""
    strange = [frame for frame in labelled.asked if frame not in scene.frames]
    if not labelled.asked or strange:
        return f"found labelled frames {_some(strange) or 'none'}, expected {_some(scene.frames)}"
    if not scene.texts and set(labelled.frames) != set(scene.frames):
        return f"found labelled frames {_some(labelled.frames)}, expected {_some(scene.frames)}"
    if scene.texts:
        texts = list(
            dict.fromkeys(text.casefold() for texts in labelled.asked.values() for text in texts)
        )
        published_texts = {text.casefold() for text in scene.texts}
        strange = [text for text in texts if text not in published_texts]
        if not texts or len(strange) > (1 - SHARE) * len(texts):
            return f"found labels of {_some(strange) or 'nothing'}, expected {_some(scene.texts)}"
    if scene.size is not None:
        for frame in labelled.asked:
            if labelled.sizes.get(frame) != scene.size:
                has = "x".join(map(str, labelled.sizes.get(frame, ()))) or "no size"
                return f"found {frame} of {has} pixels, expected {'x'.join(map(str, scene.size))}"
    return ""


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
