"""Packages that optional parts need, as the installed package itself declares them."""

from importlib.metadata import PackageNotFoundError, requires

from packaging.requirements import Requirement

PACKAGE = "slgaussian"


def requirements(extra: str | None = None) -> list[Requirement]:
    """Return the packages that are always needed, or that an extra needs besides.

    Raises
    ------
    importlib.metadata.PackageNotFoundError
        If slgaussian runs from its sources and is not installed.
    """
    declared = [Requirement(line) for line in requires(PACKAGE) or []]
    if extra is None:
        return [needs for needs in declared if needs.marker is None]
    return [n for n in declared if n.marker is not None and n.marker.evaluate({"extra": extra})]


def install_line(extra: str) -> str:
    """The command that installs what an extra needs, in backquotes.

    It names the packages and not ``slgaussian[extra]``, which an index may not have.
    """
    try:
        needed = " ".join(f"'{needs.name}{needs.specifier}'" for needs in requirements(extra))
    except PackageNotFoundError:
        needed = f"'.[{extra}]'"
    return f"`pip install {needed}`"
