"""Interface of the methods that the benchmark compares: answer texts from any camera.

:class:`slgaussian.field.SemanticField` and its views implement these protocols. Scoring uses only
this interface.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any, Protocol, runtime_checkable

import numpy as np

from slgaussian.errors import InputError
from slgaussian.scene import Camera


@runtime_checkable
class Reader(Protocol):
    """Vocabulary check of a method's text encoder."""

    def unknown_words(self, text: str) -> tuple[str, ...]:
        """Return the ignored words of ``text``; InputError if all words are unknown."""


def keep_understood(reader: Reader, texts: Iterable[str]) -> list[str]:
    """Return the texts of which any part is understood; others are answered right by chance."""
    read, answered = getattr(reader, "understood", None), []
    for text in texts:
        with suppress(InputError):
            # Readers of other packages need not have ``understood``.
            understood: Any = read(text) if read else reader.unknown_words(text)
            if not read or understood.read_as or not understood.untold:
                answered.append(text)
    return answered


@runtime_checkable
class Result(Protocol):
    """Answer to a text in one image of ``height`` H and ``width`` W.

    Attributes:
        mask: bool [H, W]. Pixels that the rules select.
        relevancy: float32 [H, W]. In [0, 1]; 0.5 means as good as the canonical phrases; 0 where
            unknown.
        point: Column and row (x, y) of the predicted location; None if no pixel is known.
        score: Largest relevancy; 0 if no pixel is known.
        unknown: Ignored words of the text.
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
    """A rendered view of a scene that answers texts.

    Attributes:
        rgb: uint8 [H, W, 3]. Rendered colours at the camera's size.
        ids: int32 [H, W]. Object ids, 0 for no object; all 0 for a method without objects.
        depth: float32 [H, W]. z-depth in scene units, 0 where unknown.
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

        Raises InputError if there is no text, or a text that cannot be used.
        """

    def segment(self, texts: Sequence[str], **rules: Any) -> np.ndarray:
        """Label pixels by the best text: int32 [H, W], 0 = unknown, k + 1 = ``texts[k]``.

        Raises InputError as :meth:`query_all`.
        """


@runtime_checkable
class Answering(Protocol):
    """A scene that answers texts from any camera."""

    def render(self, camera: Camera) -> AnsweringView:
        """Render the view of ``camera``; other work may be deferred to the first query."""
