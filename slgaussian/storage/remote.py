"""Locations given as URLs: checks, opening, and explanations of errors.

The library of each file system repeats failed requests with exponential backoff (s3fs and botocore
five times each, or ``AWS_MAX_ATTEMPTS``).
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

CONNECT_TIMEOUT, READ_TIMEOUT = 10, 30
"""Timeouts of S3 in seconds: for the connection, and for the next bytes."""

_LOGIN_PATTERN = re.compile(
    r"://[^/:@\s]*:(?!\d+(?:/|$))[^@\s]*@"
)  # a number after the colon is a port
_SECRET_PATTERN = re.compile(
    r"([?&;][^=&;\s]*(?:key|secret|token|password|signature|credential|sig)[^=&;\s]*=)[^&;\s]*",
    re.IGNORECASE,
)

_CREDENTIALS = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE"


def check_url(url: str | os.PathLike[str], name: str) -> None:
    """Raise :class:`InputError` if a URL contains a password, key or token.

    URLs appear in messages, manifests, process lists and shell histories. The message has the URL
    without its credentials.

    Args:
        url: str or path
        name: Beginning of the message, such as "store".
    """
    text = os.fspath(url)
    if redact(text) != text:
        raise InputError(
            f"{name} {redact(text)}: found credentials in the URL, expected none; take them out "
            f"and set environment variables ({_CREDENTIALS}, or those of its file system)"
        )


def redact(text: str) -> str:
    """Replace logins and keys in the URLs of a text by ``***``."""
    return _SECRET_PATTERN.sub(r"\1***", _LOGIN_PATTERN.sub("://***@", text))


def open_file_system(url: str | os.PathLike[str], name: str) -> tuple[AbstractFileSystem, str]:
    """Open the file system of a folder or fsspec URL; return it and the path in it.

    Listings are not cached, as other machines may write to it.

    Raises:
        InputError: If the URL contains credentials, fsspec does not know its protocol, or the
            package for that protocol is missing.
    """
    import fsspec  # takes 0.1 s, and some commands only check URLs

    check_url(url, name)
    text = os.fspath(url)
    is_s3 = text.startswith(("s3://", "s3a://"))
    options: dict[str, Any] = {"use_listings_cache": False}
    if is_s3:
        options["config_kwargs"] = {
            "connect_timeout": CONNECT_TIMEOUT,
            "read_timeout": READ_TIMEOUT,
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

        if FlexibleChecksumError not in core.S3_RETRYABLE_ERRORS:  # truncated transfers
            core.add_retryable_error(FlexibleChecksumError)
    if not path:
        raise InputError(f"{name} {text}: found no bucket, expected one as in {text}bucket/folder")
    return fs, path


def file_system_errors() -> tuple[type[Exception], ...]:
    """Return the exception types of file systems; some of S3 are not ``OSError``."""
    loaded = (
        (sys.modules.get("botocore.exceptions"), "BotoCoreError"),
        (sys.modules.get("botocore.parsers"), "ResponseParserError"),
        (sys.modules.get("aiohttp"), "ClientError"),
    )
    return (OSError, *(getattr(module, error) for module, error in loaded if module is not None))


def explain_error(error: Exception) -> str:
    """Describe an error of :func:`file_system_errors`; those of remote file systems with advice."""
    if isinstance(error, OSError) and error.errno and error.strerror:
        return redact(error.strerror)
    message = redact(" ".join(str(error).split())) or type(error).__name__
    return (
        f"{message}; check the network, the bucket (which is never made), its rights, "
        f"AWS_ENDPOINT_URL and the credentials ({_CREDENTIALS})"
    )
