"""Arguments and options that are the same for several commands."""

from pathlib import Path
from typing import Annotated

import typer

Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for every stage.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]
