"""What is published of a labelled scene, for readers of data sets to say."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LabelledScene:
    """By what a published scene is known.

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
