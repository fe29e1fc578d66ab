"""Where files from outside were known before :mod:`slgaussian.io` did it."""

from slgaussian.io import CHANGED, SETTLED, KnownFile, file_digest, file_stamp

__all__ = ["CHANGED", "SETTLED", "KnownFile", "file_digest", "file_stamp"]
