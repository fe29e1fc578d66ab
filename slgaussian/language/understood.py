"""An encoder's reading of a text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from slgaussian.language.confidence import TYPICAL_MEASUREMENTS


@dataclass(frozen=True)
class Understood:
    """An encoder's reading of a text.

    Attributes:
        read_as: The words that count, in the encoder's spelling.
        unknown: tuple of str. Unknown words, which are ignored.
        unused: {word: reason}. Other ignored words, such as "plant" of "plant pot".
        kind: ``known``: answered by the encoder, which knows every word that counts. ``unknown``:
            answered by the encoder without the unknown words. ``named``: answered by the objects
            with this name. ``taught``: answered by the examples of a taught word. ``picture``: the
            query is a picture or an object, not a text.
        examples: Number of examples of a taught word.
        instead_of: For a name or a taught word, the encoder's reading of it, if it has one.
        measurements: Number of measurements that the text asks for, or the typical number.
        named: Evidence of the classifier; see :class:`slgaussian.language.confidence.Signs`.
        describing: Number of words that describe the noun.
        classes: tuple of int. ImageNet classes of the noun.
        untold: Reason why the text cannot be answered; empty if it can.
        question: Suggestions for unknown words, as the end of a sentence.
    """

    read_as: str
    unknown: tuple[str, ...]
    unused: Mapping[str, str]
    kind: str = "known"
    examples: int = 0
    instead_of: str = ""
    measurements: int = TYPICAL_MEASUREMENTS
    named: float = 0.0
    describing: int = 0
    classes: tuple[int, ...] = ()
    untold: str = ""
    question: str = ""

    @property
    def alone(self) -> str:
        """Note that unknown words are ignored, as the end of a sentence; empty without any."""
        return f", for {self.read_as!r} alone{self.question}" if self.unknown else ""
