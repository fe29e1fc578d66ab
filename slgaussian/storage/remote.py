"""Places given as URLs: which are refused, how they are opened, and what their errors mean.

What a network does to a request passes, mostly: the library of each file system asks again, after a
while that grows (of S3, s3fs and botocore five times each, or ``AWS_MAX_ATTEMPTS``).
"""

from __future__ import annotations

import os
import re
import sys
from typing import TYPE_CHECKING, Any

from slgaussian.errors import InputError
from slgaussian.extras import install_line

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

CONNECT, ANSWER = 10, 30
"""Seconds that a server of S3 may take to be reached, and then to send the next bytes."""

_LOGIN = re.compile(r"://[^/:@\s]*:(?!\d+(?:/|$))[^@\s]*@")  # a number after the colon is a port
_QUERY = re.compile(
    r"([?&;][^=&;\s]*(?:key|secret|token|password|signature|credential|sig)[^=&;\s]*=)[^&;\s]*",
    re.IGNORECASE,
)

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
    is_s3 = text.startswith(("s3://", "s3a://"))
    options: dict[str, Any] = {"use_listings_cache": False}
    if is_s3:
        options["config_kwargs"] = {
            "connect_timeout": CONNECT,
            "read_timeout": ANSWER,
            **fsspec.config.conf.get("s3", {}).get("config_kwargs", {}),
        }
    try:
        fs, path = fsspec.core.url_to_fs(text, **options)
    except ImportError as error:
        protocol = text.partition("://")[0].rpartition("::")[2]
        needed = f"s3fs ({install_line('s3')})" if protocol in ("s3", "s3a") else f"{error}"
        raise InputError(f"{name} {text}: needs {needed}; or choose a folder") from error
    except ValueError as error:
        raise InputError(f"{name} {text}: {error}; or choose a folder") from error
    if is_s3:
        from botocore.exceptions import FlexibleChecksumError
        from s3fs import core

        if FlexibleChecksumError not in core.S3_RETRYABLE_ERRORS:  # what was cut on the way
            core.add_retryable_error(FlexibleChecksumError)
    if not path:
        raise InputError(
            f"{name} {text}: found no bucket in it, expected as in {text}bucket/folder"
        )
    return fs, path


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
