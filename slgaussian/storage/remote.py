"""Places given as URLs: which are refused, when they are asked again, and what their errors mean.

What a network does to a request passes, mostly. So a request that failed in such a way is made
again, after a while that grows (:func:`patiently`). That is done here and nowhere else: the
libraries below are told to try once, as tries within tries would multiply.
"""

from __future__ import annotations

import errno
import os
import random
import re
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from slgaussian.errors import InputError
from slgaussian.extras import install_line

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

Result = TypeVar("Result")

TRIES = 8
"""So often a request is made before its error is told. Of 5 % that fail, one in 10^10 fails so."""

FIRST, LONGEST = 0.1, 10.0
"""Seconds before the second try, about; each further wait is twice as long, up to the longest. All
tries together take 13 seconds if they fail at once."""

CONNECT, ANSWER = 10, 30
"""Seconds that a server of S3 may take to be reached, and then to send the next bytes."""

_LOGIN = re.compile(r"://[^/:@\s]*:(?!\d+(?:/|$))[^@\s]*@")  # a number after the colon is a port
_QUERY = re.compile(
    r"([?&;][^=&;\s]*(?:key|secret|token|password|signature|credential|sig)[^=&;\s]*=)[^&;\s]*",
    re.IGNORECASE,
)

_DAMAGED_ON_THE_WAY = {"BadDigest", "IncompleteBody", "RequestTimeout", "XAmzContentSHA256Mismatch"}
_PASSING = {errno.EIO, errno.EREMOTEIO, errno.EBUSY, errno.EPIPE}
"""Of errors of the system; the first three are also what S3's errors of a server become."""
_PASSING_KINDS = {
    "HTTPClientError",
    "IncompleteReadError",
    "ResponseParserError",
    "FlexibleChecksumError",
    "ClientError",
}
"""Names of the errors of botocore and, the last, of aiohttp that come of the network."""
_NO_CREDENTIALS = {
    "NoCredentialsError",
    "PartialCredentialsError",
    "CredentialRetrievalError",
    "ProfileNotFound",
}
_LOGINS = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE"


def check_url(url: str | os.PathLike[str], name: str) -> None:
    """Raise :class:`InputError` if a place is written with a password, key or token in it.

    What is in a URL ends in messages, manifests, process lists and shell histories. The message
    says the rest of it only.

    Parameters
    ----------
    url : str or path
    name : str
        What it is of, to begin the message with.
    """
    text = os.fspath(url)
    if redacted(text) != text:
        raise InputError(
            f"{name} {redacted(text)}: found credentials in the URL, expected none; take them out "
            f"and give them by the environment ({_LOGINS}, or what else its file system reads)"
        )


def redacted(text: str) -> str:
    """Return a text with ``***`` for logins and keys in its URLs."""
    return _QUERY.sub(r"\1***", _LOGIN.sub("://***@", text))


def open_place(url: str | os.PathLike[str], name: str) -> tuple[AbstractFileSystem, str]:
    """Open the file system of a folder or fsspec URL; return it and the path in it.

    Its listings are asked anew every time: other machines write there too.

    Raises
    ------
    InputError
        If the URL holds credentials, fsspec does not know it, or the package is missing that
        speaks its protocol.
    """
    import fsspec  # a tenth of a second, and URLs are checked by commands that open nothing

    check_url(url, name)
    text = os.fspath(url)
    options: dict[str, Any] = {"use_listings_cache": False}
    if text.startswith(("s3://", "s3a://")):
        options["config_kwargs"] = {
            "connect_timeout": CONNECT,
            "read_timeout": ANSWER,
            **fsspec.config.conf.get("s3", {}).get("config_kwargs", {}),
            "retries": {"total_max_attempts": 1},
        }
    try:
        fs, path = fsspec.core.url_to_fs(text, **options)
    except ImportError as error:
        protocol = text.partition("://")[0].rpartition("::")[2]
        needed = f"s3fs ({install_line('s3')})" if protocol in ("s3", "s3a") else f"{error}"
        raise InputError(f"{name} {text}: needs {needed}; or choose a folder") from error
    except ValueError as error:
        raise InputError(f"{name} {text}: {error}; or choose a folder") from error
    if "config_kwargs" in options:
        fs.retries = 1
    if not path:
        raise InputError(
            f"{name} {text}: found no bucket in it, expected as in {text}bucket/folder"
        )
    return fs, path


def patiently(ask: Callable[[], Result]) -> Result:
    """Return what ``ask`` returns, asked again while it fails as networks do.

    It may have been done though it failed, so it must be the same to do it twice.

    Raises
    ------
    One of :func:`troubles`
        Of the last try, or the first that waiting does not help.
    """
    for tried in range(1, TRIES + 1):
        try:
            return ask()
        except troubles() as error:
            if tried == TRIES or not _passes(error):
                raise
            # Not all of many that failed at once come back at once.
            wait = min(LONGEST, FIRST * 2 ** (tried - 1))
            time.sleep(wait * random.uniform(0.5, 1.0))
    raise AssertionError  # the last try has raised


def _passes(error: Exception) -> bool:
    """Tell whether an error may be gone in a while."""
    answer = getattr(error.__cause__, "response", None) or {}
    status = answer.get("ResponseMetadata", {}).get("HTTPStatusCode", 0)
    code = answer.get("Error", {}).get("Code", "")
    if status >= 500 or status == 429 or code in _DAMAGED_ON_THE_WAY:
        return status != 501
    kinds = {kind.__name__ for kind in type(error).__mro__}
    if kinds & _PASSING_KINDS or isinstance(error, TimeoutError | ConnectionError):
        return True
    return isinstance(error, OSError) and error.errno in _PASSING


def troubles() -> tuple[type[Exception], ...]:
    """Return the errors that file systems raise; those of S3 are not all ``OSError``."""
    loaded = (
        (sys.modules.get("botocore.exceptions"), "BotoCoreError"),
        (sys.modules.get("botocore.parsers"), "ResponseParserError"),
        (sys.modules.get("aiohttp"), "ClientError"),
    )
    return (OSError, *(getattr(module, error) for module, error in loaded if module is not None))


def explained(error: Exception, path: str = "") -> str:
    """Describe one of :func:`troubles`, with what to do about it; ``path`` is for a bucket's name.

    An error of the local disk is said as the system says it.
    """
    kind = type(error).__name__
    if isinstance(error, OSError) and error.strerror and not isinstance(error, PermissionError):
        return error.strerror
    message = redacted(" ".join(str(error).split())) or kind
    if kind in _NO_CREDENTIALS:
        return f"no credentials: {message}; set {_LOGINS}"
    if isinstance(error, FileNotFoundError) and "bucket" in message:
        return f"no bucket {path.split('/')[0]!r}: {message}; make it first, or correct its name"
    if isinstance(error, PermissionError):
        do = f"; check the credentials ({_LOGINS}) and the bucket's rights"
        return f"no permission: {message}{'' if error.errno else do}"
    if isinstance(error, TimeoutError | ConnectionError) or not isinstance(error, OSError):
        do = "check the network, and AWS_ENDPOINT_URL if the server is yours"
        return f"no answer: {message}; {do}"
    return message
