"""Errors that a user can cause, each with a one-sentence message that includes a remedy.

Any other exception that leaves the library is a defect of the library. The command line prints
these without a traceback and exits with status 2; a batch records them in ``failures.parquet``.
"""

import difflib
import re
from collections.abc import Iterable

_LONG_WORD = re.compile(r"[^\s/]{256,}")  # longer than a file name can be
_MAX_NAMED = 4  # numbers of groups, and of names in a group, that a message lists
_CONTROL_CHARACTERS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


class SLGaussianError(Exception):
    """Base class of all errors whose message is written for the user.

    Messages may quote untrusted files, so control characters and lone surrogates are escaped, and
    words of more than 255 characters are truncated.
    """

    def __init__(self, message: str = "", *more: object) -> None:
        super().__init__(one_line(message), *more)


class InputError(SLGaussianError, ValueError):
    """An image, camera, query or argument that cannot be used as given."""


class SpecError(SLGaussianError):
    """A stored artifact that is missing, damaged or breaks its spec."""


def check_type(value: object, expected: type, expectation: str) -> None:
    """Raise InputError unless a value is an instance of a type.

    ``expectation`` names the argument and the expected type: "render: expected a Camera".
    """
    if not isinstance(value, expected):
        raise InputError(f"{expectation}; found a {type(value).__name__}")


def did_you_mean(text: object, options: Iterable[str]) -> str:
    """Return the end of a message about an unknown name, with the most similar option.

    ``"; did you mean 'field'?"`` for ``"feild"``, and ``""`` if no option is similar. Case and the
    difference between hyphen and underscore are ignored.
    """
    plain = {_plain(name): name for name in options}
    near = difflib.get_close_matches(_plain(str(text)), plain, n=1)
    return f"; did you mean {plain[near[0]]!r}?" if near else ""


def join_names(groups: Iterable[Iterable[str]]) -> str:
    """List groups of names for a message, for example unconnected views; long lists are cut."""
    sorted_groups = [sorted(names) for names in groups]
    parts = []
    for names in sorted_groups[:_MAX_NAMED]:
        suffix = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
        parts.append(", ".join(map(repr, names[:_MAX_NAMED])) + suffix)
    rest = sum(map(len, sorted_groups[_MAX_NAMED:]))
    return "; ".join([*parts, f"{rest} more"] if rest else parts)


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")


def one_line(message: str) -> str:
    """Return a message as one line that is safe to print and store."""
    text = _LONG_WORD.sub(lambda word: f"{word[0][:100]}…", str(message))
    return _CONTROL_CHARACTERS.sub(lambda sign: repr(sign[0])[1:-1], text)
