"""Recognition of the published scenes of LERF-OVS and 3D-OVS by content, not by folder names.

They are identified by their labelled frames, the size of those photographs and the labelled texts,
as far as public sources list them (``published.toml``).
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
        Labelled frames, without extension.
    texts : tuple of str
        Labelled texts; empty if no public source lists them.
    size : (width, height), optional
        Size of the photographs in pixels, if a public source gives it.
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
"""Published scenes by data format and name."""

SHARE = 0.75
"""Smallest fraction of published texts among the labelled ones: lists of texts were published
separately from the labels, and a few may be missing or spelled differently."""

RECOGNISED, UNVERIFIED, ANOTHER = "recognised", "unverified", "another"


@dataclass(frozen=True)
class LabelledFrames:
    """Labels of an evaluated scene.

    Attributes
    ----------
    format, name : str
        Data format, and name of the scene's folder.
    texts : {frame: texts}
        Labelled texts of the evaluated frames, by frame without extension.
    frames : sequence of str
        All frames with labels.
    sizes : {frame: (width, height)}
        Size in pixels of the evaluated photographs that can be opened.
    """

    format: str
    name: str
    texts: Mapping[str, Sequence[str]]
    frames: Sequence[str] = ()
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Standing:
    """Relation of a scene to the published scenes.

    Attributes
    ----------
    standing : str
        :data:`RECOGNISED`; :data:`UNVERIFIED` if everything published agrees, but the texts are not
        published; or :data:`ANOTHER`: a different scene with the name of a published one.
    format, scene : str
        The published scene.
    why : str
        Difference found for :data:`ANOTHER`, with the expected value.
    """

    standing: str
    format: str
    scene: str
    why: str = ""


def standing(labelled: LabelledFrames) -> Standing | None:
    """Return the published scene with this content, or with only this name; None if neither.

    The folder of a published scene may have any name. If its texts are not published, it must have
    the scene's name and all of its labelled frames.
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
    """Describe the first difference from a published scene; empty if there is none."""
    strange = [frame for frame in labelled.texts if frame not in scene.frames]
    if not labelled.texts or strange:
        return f"found labelled frames {_some(strange) or 'none'}, expected {_some(scene.frames)}"
    if not scene.texts and set(labelled.frames) != set(scene.frames):
        return f"found labelled frames {_some(labelled.frames)}, expected {_some(scene.frames)}"
    if scene.texts:
        texts = list(
            dict.fromkeys(text.casefold() for texts in labelled.texts.values() for text in texts)
        )
        published_texts = {text.casefold() for text in scene.texts}
        strange = [text for text in texts if text not in published_texts]
        if not texts or len(strange) > (1 - SHARE) * len(texts):
            return f"found labels of {_some(strange) or 'nothing'}, expected {_some(scene.texts)}"
    if scene.size is not None:
        for frame in labelled.texts:
            if labelled.sizes.get(frame) != scene.size:
                has = "x".join(map(str, labelled.sizes.get(frame, ()))) or "no size"
                return f"found {frame} of {has} pixels, expected {'x'.join(map(str, scene.size))}"
    return ""


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
