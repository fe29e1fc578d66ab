"""The errors a user can cause, each carrying one sentence that says what to do.

Anything else that escapes the library is a defect of the library. The command line prints these
without a traceback and exits with status 2; a batch records them in ``failures.parquet``.
"""


class SLGaussianError(Exception):
    """Base of every error whose message is written for the user."""


class InputError(SLGaussianError, ValueError):
    """An image, camera, query or argument that cannot be used as given."""


class SpecError(SLGaussianError):
    """A stored artifact that is missing, damaged or not what its spec says."""
