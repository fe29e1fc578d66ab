"""`python -m slgaussian`: the program `slgaussian`, as this installation has it."""

import os
import sys

if __name__ == "__main__":
    # Python puts the working folder first, where a folder called as one of our packages may be.
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if not sys.flags.safe_path and sys.path[0] != here:
        del sys.path[0]
    from importlib.metadata import entry_points

    # Found by its name: the library does not know what is built upon it.
    scripts = entry_points(group="console_scripts", name="slgaussian")
    if not scripts:
        raise SystemExit("error: slgaussian is not installed here; give `pip install` its folder")
    sys.exit(next(iter(scripts)).load()())
