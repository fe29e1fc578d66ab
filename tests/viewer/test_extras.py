"""All extras can be installed together, in the versions that constraints.txt pins."""

import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    split = (line.split("==") for line in lines if line and not line.startswith("#"))
    return {canonicalize_name(name): version for name, version in split}


def wanted() -> list[tuple[str, Requirement]]:
    """What the package and its extras want, and what that wants, as far as it is installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [(name, line) for name, own in [("", project["dependencies"]), *extras.items()]
             for line in own]  # fmt: skip
    waiting = [(f"[{name}]", Requirement(line)) for name, line in lines]
    found, seen = [], set()
    while waiting:
        by, needs = waiting.pop()
        name = canonicalize_name(needs.name)
        if name == "slgaussian":
            continue
        found.append((by, needs))
        for extra in ("", *needs.extras):
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            try:
                declared = map(Requirement, requires(name) or [])
            except PackageNotFoundError:
                continue
            waiting += [(name, r) for r in declared
                        if r.marker is None or r.marker.evaluate({"extra": extra})]  # fmt: skip
    return found


def test_every_requirement_of_every_extra_is_met_by_the_pins():
    pins, found = pinned(), wanted()
    names = {canonicalize_name(needs.name) for _, needs in found}
    assert {"uvicorn", "rich", "prefect", "prefect-dask", "transformers"} <= names
    unmet = [
        f"{by} wants {needs}, pinned is {pins[name]}"
        for by, needs in found
        if (name := canonicalize_name(needs.name)) in pins
        and not needs.specifier.contains(Version(pins[name]), prereleases=True)
    ]
    assert unmet == []
    assert pins["rich"].startswith("14.")
