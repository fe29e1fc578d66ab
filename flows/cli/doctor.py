"""Is this installation able to run? Each check tries the real thing, and one never stops another.

Whatever may be broken is imported within the check that is about it.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import tempfile
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata, version
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from flows.runners.environment import home_of, orchestration
from flows.settings import Settings
from slgaussian import __version__
from slgaussian.errors import InputError, SLGaussianError, one_line
from slgaussian.kernels import threads
from slgaussian.parts.extras import PACKAGE, install_line, requirements
from slgaussian.parts.finding import Finding, Findings
from slgaussian.parts.hub_cache import local_place
from slgaussian.parts.registry import KINDS, find_part
from slgaussian.parts.settings import Setting, settings_of
from slgaussian.storage.remote import redacted

SHOWN = ("torch", "numpy", "numba", "pyarrow", "prefect", "fastapi", "sqlalchemy")
"""Packages whose versions are told even if all is well."""
MODULES = {"opencv-contrib-python-headless": "cv2", "scikit-image": "skimage", "pillow": "PIL"}
"""What packages are imported as, where that is not their name."""

DEVELOPMENT = ("test", "docs")
"""Extras for those who work on slgaussian itself."""

ROOM = 2**30
"""Bytes that the disk of the store should have left: a scene of default size takes some 30 MB."""

ANSWER = 10.0
"""Seconds to wait for a server that is said to run."""


def examine(settings: Settings, runner: bool = False) -> Findings:
    """All checks, one after the other.

    Parameters
    ----------
    settings : Settings
        The store, the runner, and the parts of the method with their files.
    runner : bool
        Whether to look at the runner.
    """
    with ExitStack() as stack:
        usable: list[Any] = []
        begun: list[Callable[[], Findings]] = []
        store = list(_tried("store", lambda: _store(settings.store, usable)))
        if not usable or (usable[0].local and not home_of(usable[0]).exists()):
            # The server would leave its database in the store.
            usable.append(_opened(stack.enter_context(tempfile.TemporaryDirectory())))
        # It comes up while the other checks import what they check.
        server = list(_tried("server", lambda: _begin_server(usable[-1], stack, begun)))
        yield Finding(PACKAGE, f"{__version__}, Python {platform.python_version()}")
        yield from _tried("packages", _packages)
        yield from _tried("extras", _extras)
        yield from _tried("threads", _threads)
        yield from [*store, *server]
        for ready in begun:
            yield from _tried("server", ready)
        if runner:
            yield from _tried("runner", lambda: _runner(settings, usable[0]))
    yield from _tried("models", lambda: _models(settings))


def _tried(name: str, check: Callable[[], Findings]) -> Findings:
    try:
        yield from check()
    except SLGaussianError as error:
        said = str(error).removeprefix(f"{name} ").removeprefix(f"{name}: ")
        yield Finding(name, said, False)
    except Exception as error:  # whatever it is, the other checks go on
        said = one_line(f"{type(error).__name__}: {error}")
        advice = "install it again as the README says"
        yield Finding(name, f"cannot be checked ({said}); {advice}", False)


def _packages() -> Findings:
    """Look at the packages that are always needed, with the bounds of pyproject.toml."""
    try:
        needed = requirements()
    except PackageNotFoundError:
        said = "slgaussian itself is not installed; run `pip install -c constraints.txt .`"
        yield Finding("packages", said, False)
        return
    good: dict[str, str] = {}
    for needs in needed:
        wrong = _wrong(needs)
        if wrong is None:
            good[needs.name] = version(needs.name)
        else:
            advice = f"run `pip install '{needs.name}{needs.specifier}'`"
            yield Finding(needs.name, f"{wrong}; {advice}", False)
    shown = ", ".join(f"{name} {good[name]}" for name in SHOWN if name in good)
    yield Finding("packages", f"{len(good)} of {len(needed)} as they must be: {shown}")


def _extras() -> Findings:
    """Look at the packages for more than the main job; none of them must be there.

    They are imported only by the checks of what needs them: a runner, a model.
    """
    for extra in metadata(PACKAGE).get_all("Provides-Extra") or []:
        if extra in DEVELOPMENT:
            continue
        own = requirements(extra)
        told = {needs: _wrong(needs, importing=False) for needs in own}
        there = [f"{needs.name} {version(needs.name)}" for needs, said in told.items() if not said]
        wrong = [said for said in told.values() if said]
        advice = f"; {install_line(extra)}" if wrong else ""
        yield Finding(f"[{extra}]", ", ".join([*there, *wrong]) + advice, None)


def _wrong(needs: Requirement, importing: bool = True) -> str | None:
    """What is wrong with a package, if anything: that it is not there, too old, broken ..."""
    try:
        found = version(needs.name)
    except PackageNotFoundError:
        return f"{needs.name} is not installed"
    if not needs.specifier.contains(found, prereleases=True):
        return f"{needs.name}: found {found}, expected {needs.specifier}"
    if not importing:
        return None
    try:
        import_module(MODULES.get(needs.name, needs.name.replace("-", "_")))
    except Exception as error:  # a broken package raises anything
        return f"{needs.name} {found} cannot be imported ({one_line(str(error))})"
    return None


def _threads() -> Findings:
    yield Finding("threads", f"{threads.cores()} cores")


def _opened(place: str) -> Any:
    from slgaussian.storage.store import ArtifactStore

    return ArtifactStore(place)


def _store(place: str, usable: list[Any]) -> Findings:
    store = _opened(place)
    with _folders_removed(Path(store.path) if store.local else None):
        store.check_writable()
        free = shutil.disk_usage(store.path).free if store.local else None
    usable.append(store)
    if free is None:
        yield Finding("store", f"{store.root} answers and can be written")
        return
    left = f"{free / 2**30:.1f} GiB free"
    if free < ROOM:
        advice = "make room (`slgaussian store gc`), or choose another with --store"
        yield Finding("store", f"{store.root} has only {left}; {advice}", False)
    else:
        yield Finding("store", f"{store.root} can be written, {left}")


@contextmanager
def _folders_removed(place: Path | None) -> Iterator[None]:
    """Remove what the block makes of the folders down to ``place``, if nothing is in them."""
    missing = [] if place is None else [p for p in (place, *place.parents) if not p.exists()]
    try:
        yield
    finally:
        with suppress(OSError):
            for folder in missing:
                folder.rmdir()


def _begin_server(store: Any, stack: ExitStack, begun: list[Callable[[], Findings]]) -> Findings:
    """Add to ``begun`` the check of a server of our own, which is not up yet, or of that given."""
    given = os.environ.get("PREFECT_API_URL")
    ready = stack.enter_context(orchestration(store))

    def check() -> Findings:
        ready()
        said = f"{_version(given)} answers at {redacted(given)}" if given else "starts and answers"
        yield Finding("server", f"Prefect's server {said}")

    begun.append(check)
    yield from ()


def _version(url: str) -> str:
    try:
        with urllib.request.urlopen(f"{url}/admin/version", timeout=ANSWER) as answer:
            return str(json.load(answer))
    except (OSError, ValueError) as error:
        raise InputError(
            f"PREFECT_API_URL {redacted(url)}: no Prefect server answers there ({error}); start it "
            "with `prefect server start`, correct the variable, or unset it"
        ) from error


def _runner(settings: Settings, store: Any) -> Findings:
    from flows.runners.task_runners import check_runner

    check_runner(settings.runner, store)
    there = "answers" if "://" in settings.runner else "can be started"
    yield Finding("runner", f"{settings.runner} {there}")


def _models(settings: Settings) -> Findings:
    """The files that the chosen parts need, as far as their headers."""
    declared = {}
    for kind, part in settings.part_names().items():
        try:
            declared[part] = settings_of(find_part(kind, part))
        except InputError as error:
            unknown = f"unknown {KINDS[kind].called} {part!r}: "
            said = str(error)
            if said.startswith(unknown):
                said = f"found {part!r}, {said.removeprefix(unknown)}"
            yield Finding(kind, said, False)
    for part, own in settings.part_settings().items():
        for name, setting in declared[part].items():
            place = own[name]
            if setting.content is not None and place is not None:
                yield from _tried(part, partial(_file, part, setting, place))
            elif setting.content is not None and not setting.optional:
                yield Finding(part, f"its {name} is not given; give --{part}-{name} PLACE", False)


def _file(part: str, setting: Setting, place: str | Path) -> Findings:
    """A file of a part, or a folder of some, by what it is known by."""
    from slgaussian.masks.precomputed import folder_digest
    from slgaussian.parts import pretrained
    from slgaussian.semantic.trained import weights_digest

    name, place, good = setting.name, str(place), True
    if part == "mvsplat":
        from slgaussian.predict.mvsplat.checkpoint import read_state

        files, said = [], f"{len(read_state(place))} tensors"
    elif setting.content is weights_digest:
        from slgaussian.semantic.branch import find_weights

        files, said = [find_weights(place)], "weights"
    elif setting.content is pretrained.model_digest:
        import transformers  # noqa: F401  that it is there

        files = list(pretrained.find_model(local_place(place)).files)
        said = "a model"
    elif setting.content is pretrained.tokenizer_digest:
        pretrained.find_tokenizer(local_place(place))
        files, said = [], "a tokenizer"
    elif setting.content is folder_digest:
        files = [file for file in Path(place).iterdir() if file.is_file()][:1]
        said = "id maps" if files else "no file; give the folder of the id maps"
        good = bool(files)
    else:
        files = [] if Path(place).is_dir() else [Path(place)]
        said = "a table" if name == "table" else "is there"
    read = sum(_readable(file) for file in files)
    amount = f", {read / 2**20:.0f} MiB" if read >= 2**20 else ""
    yield Finding(part, f"{name} {place}: {said}{amount}", good)


def _readable(file: Path) -> int:
    """Bytes of a file whose beginning can be read; InputError if it cannot, or says nonsense."""
    try:
        with file.open("rb") as stream:
            begin = stream.read(8)
        size = file.stat().st_size
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); correct its name") from error
    header = int.from_bytes(begin, "little")
    if file.suffix == ".safetensors" and not 0 < header <= size - 8:
        raise InputError(f"{file}: is damaged, or no safetensors file; get it again")
    return size
