"""Interface that a method has to have, to be compared: answer texts, from any camera.

A :class:`slgaussian.field.SemanticField` and its views are of these shapes as they are. Whatever
scores a method asks no more of it than this.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import Camera


@runtime_checkable
class Reader(Protocol):
    """Says which words of a text are understood."""

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """The words of ``text`` that are left out; InputError if none can be used."""


def understands(reader: Reader, text: str) -> bool:
    """Tell whether anything is known of a text; else an answer is right by luck alone."""
    try:
        reader.unknown_words(text)
    except InputError:
        return False
    if not hasattr(reader, "understood"):  # readers of other packages need not have it
        return True
    understood = reader.understood(text)
    return bool(understood.read_as) or not understood.untold


@runtime_checkable
class Result(Protocol):
    """Answer to a text in one image of ``height`` H and ``width`` W.

    Attributes
    ----------
    text : str
    mask : bool [H, W]
        What the rules select.
    relevancy : float32 [H, W]
        In [0, 1]; 0.5 is "as good as any phrase"; 0 where nothing is known.
    point : (int, int) or None
        Column and row (x, y) of the best guess of where it is; None if nothing at all is known.
    score : float
        The greatest relevancy; 0 if nothing at all is known.
    unknown : tuple of str
        Words of the text that were left out.
    """

    @property
    def text(self) -> str: ...  # noqa: D102
    @property
    def mask(self) -> np.ndarray: ...  # noqa: D102
    @property
    def relevancy(self) -> np.ndarray: ...  # noqa: D102
    @property
    def point(self) -> tuple[int, int] | None: ...  # noqa: D102
    @property
    def score(self) -> float: ...  # noqa: D102
    @property
    def unknown(self) -> tuple[str, ...]: ...  # noqa: D102


@runtime_checkable
class AnsweringView(Protocol):
    """A scene as one camera sees it, ready to be asked.

    Attributes
    ----------
    rgb : uint8 [H, W, 3]
        The camera's size.
    ids : int32 [H, W]
        Object ids, 0 where there is none: all 0 for a method that knows no objects.
    depth : float32 [H, W]
        z-depth in scene units, 0 where it is not known.
    reader : Reader
    """

    @property
    def rgb(self) -> np.ndarray: ...  # noqa: D102
    @property
    def ids(self) -> np.ndarray: ...  # noqa: D102
    @property
    def depth(self) -> np.ndarray: ...  # noqa: D102
    @property
    def reader(self) -> Reader: ...  # noqa: D102

    def query_all(self, texts: Sequence[str], **rules: Any) -> Sequence[Result]:
        """Find each of ``texts``; ``rules`` are :class:`slgaussian.language.rules.Rules`.

        InputError if there is no text, or one that cannot be used.
        """

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """Label pixels by the best text: int32 [H, W], 0 = nothing known, k + 1 = ``texts[k]``.

        InputError as :meth:`query_all`.
        """


@runtime_checkable
class Answering(Protocol):
    """Answers texts from any camera."""

    def render(self, camera: Camera) -> AnsweringView:
        """The scene as ``camera`` sees it.

        What answers need beyond that may be left until the first text is asked.
        """
