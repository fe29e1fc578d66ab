"""Checks of an installation: each tries the real thing, and none stops another by an import."""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from flows.runners.environment import home_of, orchestration
from flows.settings import Settings
from slgaussian import __version__
from slgaussian.components.finding import Finding, Findings
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.extras import PACKAGE, install_line, requirements
from slgaussian.kernels import threads
from slgaussian.storage.remote import redacted

SHOWN = ("torch", "numpy", "numba", "pyarrow", "prefect", "fastapi", "sqlalchemy")
"""Packages whose versions are shown even if all is well."""
MODULES = {"opencv-contrib-python-headless": "cv2", "scikit-image": "skimage", "pillow": "PIL"}
"""Names under which packages are imported, where they differ from the package's."""
ROOM = 2**30
"""Bytes that the disk of the store should have left, of which a scene takes some 30 MB."""


def examine(settings: Settings, runner: bool = False) -> Findings:
    """Check packages, store, server, ``runner`` if wanted, and the models of the chosen parts."""
    opened, tables = list[Any](), settings.component_values()
    yield Finding(PACKAGE, f"{__version__}, Python {platform.python_version()}")
    yield from _tried("packages", _packages)
    with suppress(PackageNotFoundError):
        yield from _extras()
    yield Finding("threads", f"{threads.cores()} cores")
    yield from _tried("store", _store, settings.store, opened)
    yield from _tried("server", _server, *opened)
    if runner and opened:
        yield from _tried("runner", _runner, settings.runner, opened[0])
    from slgaussian.components.intact import check_component

    for kind, part in settings.component_names().items():
        yield from _tried(part, check_component, kind, part, tables.get(part, {}))


def _tried(name: str, check: Callable[..., str], *arguments: Any) -> Findings:
    try:
        if message := check(*arguments):
            yield Finding(name, message)
    except SLGaussianError as error:
        yield Finding(name, str(error).removeprefix(f"{name} ").removeprefix(f"{name}: "), False)
    except Exception as error:  # whatever it is, the other checks go on
        reason = one_line(f"{type(error).__name__}: {error}")
        yield Finding(name, f"cannot be checked ({reason}); install it as the README says", False)


def _packages() -> str:
    """Compare the packages that are always needed with the bounds of pyproject.toml."""
    needed = requirements()
    problems = {str(needs): problem for needs in needed if (problem := _problem(needs))}
    if problems:
        install = " ".join(f"'{needs}'" for needs in problems)
        raise InputError(f"{'; '.join(problems.values())}; run `pip install {install}`")
    return f"{len(needed)} as they must be: {', '.join(f'{n} {version(n)}' for n in SHOWN)}"


def _extras() -> Findings:
    """List the packages of extras; none is imported, and none must be there."""
    for extra in metadata(PACKAGE).get_all("Provides-Extra") or []:
        if extra not in ("test", "docs"):  # for work on slgaussian itself
            problems = {n.name: _problem(n, importing=False) for n in requirements(extra)}
            lines = [problem or f"{name} {version(name)}" for name, problem in problems.items()]
            lines[-1] += f"; {install_line(extra)}" if any(problems.values()) else ""
            yield Finding(f"[{extra}]", ", ".join(lines), None)


def _problem(needs: Requirement, importing: bool = True) -> str | None:
    """Return the problem of a package, if any: not there, too old, or broken."""
    try:
        installed = version(needs.name)
    except PackageNotFoundError:
        return f"{needs.name} is not installed"
    if not needs.specifier.contains(installed, prereleases=True):
        return f"{needs.name}: found {installed}, expected {needs.specifier}"
    try:
        if importing:
            import_module(MODULES.get(needs.name, needs.name.replace("-", "_")))
    except Exception as error:  # a broken package raises anything
        return f"{needs.name} {installed} cannot be imported ({one_line(str(error))})"
    return None


def _store(place: str, opened: list[Any]) -> str:
    """Write to the store and remove the folders that this makes; put the store into ``opened``."""
    from slgaussian.storage.store import ArtifactStore

    store = ArtifactStore(place)
    path = Path(store.path)
    missing = [p for p in (path, *path.parents) if store.local and not p.exists()]
    try:
        store.check_writable()
        free = shutil.disk_usage(path).free if store.local else ROOM
    finally:
        for folder in missing:
            with suppress(OSError):  # it was not made
                folder.rmdir()
    opened.append(store)
    if free < ROOM:
        advice = "make room (`slgaussian store gc`), or choose another --store"
        raise InputError(f"{store.root} has {free / 2**30:.1f} GiB free; {advice}")
    return f"{store.root} can be written"


def _server(store: Any = None) -> str:
    """Ask the server of ``PREFECT_API_URL``, or start and stop one of our own."""
    from slgaussian.storage.store import ArtifactStore

    if url := os.environ.get("PREFECT_API_URL"):
        try:
            with urllib.request.urlopen(f"{url}/admin/version", timeout=10) as answer:
                return f"Prefect's server {json.load(answer)} answers at {redacted(url)}"
        except (OSError, ValueError) as error:
            raise InputError(
                f"PREFECT_API_URL {redacted(url)}: no Prefect server answers there ({error}); "
                "start it with `prefect server start`, correct the variable, or unset it"
            ) from error
    # In a store that has no database yet, the server would leave one.
    begun = store is not None and store.local and home_of(store).exists()
    with (
        tempfile.TemporaryDirectory() as temporary,
        orchestration(store if begun else ArtifactStore(temporary)) as ready,
    ):
        ready()
    return "Prefect's server starts and answers"


def _runner(runner: str, store: Any) -> str:
    from flows.runners.task_runners import check_runner

    check_runner(runner, store)
    return f"{runner} {'answers' if '://' in runner else 'can be started'}"
