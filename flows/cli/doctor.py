"""The command `slgaussian doctor`: independent checks of the installation, store and models."""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated

import typer

from flows.cli import options
from flows.config import Settings
from flows.read_config import make_settings
from slgaussian import __version__
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.extras import PACKAGE, requirements

SHOWN_PACKAGES = ("torch", "numpy", "numba", "pyarrow", "prefect", "fastapi", "sqlalchemy")
"""Packages whose versions are always shown."""
MIN_FREE_BYTES = 2**30
"""Bytes that should be free on the disk of the store; a scene takes some 30 MB."""


@options.add_options("store", "runner", *options.COMPONENTS, "encoder")
def doctor(
    ctx: typer.Context,
    components: Annotated[bool, typer.Option("--components", help="List all components.")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema.")] = False,
) -> None:
    """Check the requirements of a run, and give advice.

    Checks packages, threads, the store, the Prefect server, numerical errors of hard cases on this
    machine, and the files and models of options; prints for each ok, or BAD with advice. Models are
    compared with the hub's digests, if they come from there, and loaded. Nothing is downloaded. The
    exit status is 1 if anything is BAD. --components and --schema print components or the schema of
    configuration files instead.

    \b
    slgaussian doctor --store s3://bucket/slg --runner dask://10.0.0.5:8786
    slgaussian doctor --encoder clip --set clip.model=models/clip-vit-b-16
    slgaussian doctor --components
    """
    from slgaussian.components.pretrained import check_component
    from slgaussian.components.registry import list_components
    from slgaussian.kernels import threads

    if components and schema:
        raise InputError("doctor: --components and --schema are two outputs; choose one")
    if components:
        typer.echo(list_components())
        return
    if schema:
        typer.echo(json.dumps(Settings.model_json_schema(), indent=1))
        return
    settings = make_settings(options.settings_from(ctx), "doctor")
    typer.echo(f"ok   {PACKAGE:<12} {__version__}, Python {platform.python_version()}")
    checks: list[tuple[str, Callable[[], str]]] = [
        ("packages", _check_packages),
        ("threads", lambda: f"{threads.cores()} cores"),
        ("store", lambda: _check_store(settings.store)),
        ("server", _check_server),
        ("numerics", _check_numerics),
    ]
    if "runner" in settings.model_fields_set:
        checks.append(("runner", lambda: _check_runner(settings.runner)))
    checks += [(each.name, partial(check_component, each)) for each in settings.components]
    passed = [_passes(name, check) for name, check in checks]
    raise typer.Exit(0 if all(passed) else 1)


def _passes(name: str, check: Callable[[], str]) -> bool:
    """Print what a check returns as ok, or why it fails as BAD; return whether it passes."""
    passes = False
    try:
        message, passes = check(), True
    except SLGaussianError as error:
        message = str(error).removeprefix(f"{name} ").removeprefix(f"{name}: ")
    except Exception as error:  # the other checks continue after any error
        reason = one_line(f"{type(error).__name__}: {error}")
        message = f"cannot be checked ({reason}); install it as the README says"
    if message:
        typer.echo(f"{'ok ' if passes else 'BAD'}  {name:<12} {message}")
    return passes


def _check_packages() -> str:
    """Compare the installed packages with the requirements in pyproject.toml."""
    needed, problems = requirements(), {}
    for needs in needed:
        try:
            installed = version(needs.name)
        except PackageNotFoundError:
            installed = "none"
        if installed == "none" or not needs.specifier.contains(installed, prereleases=True):
            problems[str(needs)] = f"{needs.name}: found {installed}, expected {needs.specifier}"
    if problems:
        install = " ".join(f"'{needs}'" for needs in problems)
        raise InputError(f"{'; '.join(problems.values())}; run `pip install {install}`")
    for name in SHOWN_PACKAGES:
        import_module(name)
    return f"{len(needed)} as required: {', '.join(f'{n} {version(n)}' for n in SHOWN_PACKAGES)}"


def _check_store(place: str) -> str:
    """Write to the store, or if it does not exist yet, to the folder in which it would be made."""
    from slgaussian.storage.store import ArtifactStore

    store = ArtifactStore(place)
    folder = Path(store.path)
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    probe = ArtifactStore(str(existing)) if store.local and existing.is_dir() else store
    probe.check_writable()
    free = shutil.disk_usage(existing).free if store.local else MIN_FREE_BYTES
    if free < MIN_FREE_BYTES:
        advice = "make room (`slgaussian store gc`), or choose another --store"
        raise InputError(f"{store.root} has {free / 2**30:.1f} GiB free; {advice}")
    return f"{store.root} can be written"


def _check_server() -> str:
    """Ask the server of ``PREFECT_API_URL``, or start and stop a local one in a temporary store."""
    import urllib.request

    from flows.runners.environment import orchestration
    from slgaussian.storage.remote import redact
    from slgaussian.storage.store import ArtifactStore

    if url := os.environ.get("PREFECT_API_URL"):
        try:
            with urllib.request.urlopen(f"{url}/admin/version", timeout=10) as answer:
                return f"Prefect's server {json.load(answer)} answers at {redact(url)}"
        except (OSError, ValueError) as error:
            raise InputError(
                f"PREFECT_API_URL {redact(url)}: no Prefect server answers there ({error}); "
                "start it with `prefect server start`, correct the variable, or unset it"
            ) from error
    with tempfile.TemporaryDirectory() as folder, orchestration(ArtifactStore(folder)) as wait:
        wait()
    return "Prefect's server starts and answers"


def _check_numerics() -> str:
    """Compare the kernels with float64 on hard cases."""
    from slgaussian.benchmark.hard_cases import measure_hard_cases

    cases = measure_hard_cases()
    wrong = [
        f"{case.part}, {case.case}: {case.error:.1e} {case.measure}, expected {case.bound:.0e}"
        for case in cases
        if not case.good
    ]
    if wrong:
        raise InputError(f"{'; '.join(wrong)}; report this, with `lscpu` and `pip list`")
    return f"{len(cases)} hard cases are within their bounds of float64"


def _check_runner(runner: str) -> str:
    from flows.runners.task_runners import check_runner

    check_runner(runner)
    return f"{runner} {'answers' if '://' in runner else 'can be started'}"
