"""Places given as URLs: which ones are refused, and what their errors mean to a user."""

from __future__ import annotations

import os
import re
import sys
from typing import TYPE_CHECKING

from slgaussian.errors import InputError
from slgaussian.parts.extras import install_line

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

_LOGIN = re.compile(r"://[^/:@\s]*:(?!\d+(?:/|$))[^@\s]*@")  # a number after the colon is a port
_QUERY = re.compile(
    r"([?&;][^=&;\s]*(?:key|secret|token|password|signature|credential|sig)[^=&;\s]*=)[^&;\s]*",
    re.IGNORECASE,
)

_NO_CREDENTIALS = {"NoCredentialsError", "PartialCredentialsError", "CredentialRetrievalError"}
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
    """``text`` with ``***`` for logins and keys in its URLs."""
    return _QUERY.sub(r"\1***", _LOGIN.sub("://***@", text))


def open_place(url: str | os.PathLike[str], name: str) -> tuple[AbstractFileSystem, str]:
    """The file system of a folder or fsspec URL, and the path in it.

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
    try:
        fs, path = fsspec.core.url_to_fs(text, use_listings_cache=False)
    except ImportError as error:
        needed = f"s3fs ({install_line('s3')})" if _is_s3(text) else f"{error}"
        raise InputError(f"{name} {text}: needs {needed}; or choose a folder") from error
    except ValueError as error:
        raise InputError(f"{name} {text}: {error}; or choose a folder") from error
    if not path:
        raise InputError(
            f"{name} {text}: found no bucket in it, expected as in {text}bucket/folder"
        )
    return fs, path


def troubles() -> tuple[type[Exception], ...]:
    """What file systems raise when they fail; those of S3 are not all ``OSError``."""
    loaded = (
        (sys.modules.get("botocore.exceptions"), "BotoCoreError"),
        (sys.modules.get("aiohttp"), "ClientError"),
    )
    return (OSError, *(getattr(module, error) for module, error in loaded if module is not None))


def explained(error: Exception, path: str = "") -> str:
    """One of :func:`troubles` in words, with what to do about it; ``path`` is for a bucket's name.

    An error of the local disk is said as the system says it.
    """
    kind = type(error).__name__
    if isinstance(error, OSError) and error.strerror and not isinstance(error, PermissionError):
        return error.strerror
    said = redacted(" ".join(str(error).split())) or kind
    if kind in _NO_CREDENTIALS or kind == "ProfileNotFound":
        return f"no credentials: {said}; set {_LOGINS}"
    if isinstance(error, FileNotFoundError) and "bucket" in said:
        return f"no bucket {path.split('/')[0]!r}: {said}; make it first, or correct its name"
    if isinstance(error, PermissionError):
        return f"no permission: {said}" + (
            "" if error.errno else f"; check the credentials ({_LOGINS}) and the bucket's rights"
        )
    if isinstance(error, TimeoutError | ConnectionError) or not isinstance(error, OSError):
        return f"no answer: {said}; check the network, and AWS_ENDPOINT_URL if the server is yours"
    return said


def _is_s3(url: str) -> bool:
    return url.partition("://")[0].rpartition("::")[2] in ("s3", "s3a")
