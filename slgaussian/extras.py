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
        return [requirement for requirement in declared if requirement.marker is None]
    return [r for r in declared if r.marker is not None and r.marker.evaluate({"extra": extra})]


def install_line(extra: str) -> str:
    """Return the command that installs the requirements of an extra, in backquotes.

    It names the packages instead of ``slgaussian[extra]``, which the index may not have.
    """
    try:
        needed = " ".join(
            f"'{requirement.name}{requirement.specifier}'" for requirement in requirements(extra)
        )
    except PackageNotFoundError:
        needed = f"'.[{extra}]'"
    return f"`pip install {needed}`"
