"""Is this installation able to run? Each check tries the real thing."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

from flows.environment import orchestration
from slgaussian import __version__, threads
from slgaussian.errors import SLGaussianError
from slgaussian.store import ArtifactStore

PACKAGES = ("torch", "numba", "numpy", "opencv-contrib-python-headless", "pyarrow", "prefect")
PACKAGES += ("fastapi",)


def examine(root: str) -> Iterator[tuple[str, str, bool]]:
    """Name, finding and whether it is good, one check after the other."""
    yield "slgaussian", f"{__version__}, Python {platform.python_version()}", True
    for package in PACKAGES:
        try:
            yield package, version(package), True
        except PackageNotFoundError:
            yield package, "not installed", False
    try:
        layer = threads.numba_layer()
        good = layer in ("omp", "tbb")
        yield "threads", f"{threads.cores()} cores, Numba layer {layer}", good
    except ValueError as error:
        yield "threads", f"{error}; install an OpenMP runtime (libgomp)", False
    store = ArtifactStore(root)
    try:
        store.check_writable()
        yield "store", f"{store.root} can be written", True
        with orchestration(store) as ready:
            ready()
            yield "server", "Prefect's server starts and answers", True
    except SLGaussianError as error:
        yield "store", str(error), False
