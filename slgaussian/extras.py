"""Requirements of optional features, from the metadata of the installed package."""

from importlib.metadata import PackageNotFoundError, requires

from packaging.requirements import Requirement

PACKAGE = "slgaussian"


def requirements(extra: str | None = None) -> list[Requirement]:
    """Return the requirements of the package, or the additional ones of an extra.

    Raises:
        importlib.metadata.PackageNotFoundError: If slgaussian runs from its sources and is not
            installed.
    """
    declared = [Requirement(line) for line in requires(PACKAGE) or []]
    if extra is None:
        return [each for each in declared if each.marker is None]
    return [r for r in declared if r.marker is not None and r.marker.evaluate({"extra": extra})]


def install_line(extra: str) -> str:
    """Return the command that installs the requirements of an extra, in backquotes.

    It names the packages instead of ``slgaussian[extra]``, which the index may not have.
    """
    try:
        needed = " ".join(f"'{each.name}{each.specifier}'" for each in requirements(extra))
    except PackageNotFoundError:
        needed = f"'.[{extra}]'"
    return f"`pip install {needed}`"
