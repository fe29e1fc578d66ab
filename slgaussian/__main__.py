"""`python -m slgaussian`: run the installed program `slgaussian`."""

import os
import sys

if __name__ == "__main__":
    # Python puts the working folder first; it may contain a folder with the name of a package.
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if not sys.flags.safe_path and sys.path[0] != here:
        del sys.path[0]
    from importlib.metadata import entry_points

    # By its entry point, because the library must not import the command line.
    scripts = entry_points(group="console_scripts", name="slgaussian")
    if not scripts:
        raise SystemExit("error: slgaussian is not installed here; give `pip install` its folder")
    sys.exit(next(iter(scripts)).load()())
