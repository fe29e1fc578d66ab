"""The errors a user can cause, each carrying one sentence that says what to do.

Anything else that escapes the library is a defect of the library. The command line prints these
without a traceback and exits with status 2; a batch records them in ``failures.parquet``.
"""

import difflib
import re
from collections.abc import Iterable

_LONG = re.compile(r"[^\s/]{256,}")  # no file has such a name
_NAMED = 4  # names of a piece, and pieces, that a message tells
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


class SLGaussianError(Exception):
    """Base of every error whose message is written for the user.

    What it quotes may come from a file that anybody wrote: what a terminal would obey, or no file
    can hold, is escaped, and words of more than 255 letters are cut.
    """

    def __init__(self, message: str = "", *more: object) -> None:
        super().__init__(one_line(message), *more)


class InputError(SLGaussianError, ValueError):
    """An image, camera, query or argument that cannot be used as given."""


class SpecError(SLGaussianError):
    """A stored artifact that is missing, damaged or not what its spec says."""


def check_type(value: object, expected: type, expectation: str) -> None:
    """Raise InputError unless a value is of a type.

    ``expectation`` names the argument and says what it takes: "render: expected a Camera".
    """
    if not isinstance(value, expected):
        raise InputError(f"{expectation}; found a {type(value).__name__}")


def did_you_mean(text: object, options: Iterable[str]) -> str:
    """The end of a sentence about a name that is none: the known name that is nearest to it.

    ``"; did you mean 'field'?"`` for ``"feild"``, and ``""`` if no known name is near. Case counts
    for nothing, and neither does the difference between a hyphen and an underscore.
    """
    plain = {_plain(name): name for name in options}
    near = difflib.get_close_matches(_plain(str(text)), plain, n=1)
    return f"; did you mean {plain[near[0]]!r}?" if near else ""


def listed(pieces: Iterable[Iterable[str]]) -> str:
    """Names of each piece of something that falls apart, not too many, as a message says them."""
    sorted_pieces = [sorted(names) for names in pieces]
    parts = []
    for names in sorted_pieces[:_NAMED]:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        parts.append(", ".join(map(repr, names[:_NAMED])) + more)
    rest = sum(map(len, sorted_pieces[_NAMED:]))
    return "; ".join([*parts, f"{rest} more"] if rest else parts)


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")


def one_line(message: str) -> str:
    """A message as one line that can be printed and stored anywhere."""
    text = _LONG.sub(lambda word: f"{word[0][:100]}…", str(message))
    return _CONTROL.sub(lambda sign: repr(sign[0])[1:-1], text)
