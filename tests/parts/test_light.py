"""What the command line asks of parts must not make anybody wait for torch."""

import subprocess
import sys

CODE = """
import sys
from slgaussian.parts.registry import KINDS, find_part, names_of
from slgaussian.parts.settings import settings_of
for kind in KINDS:
    for name in names_of(kind):
        settings_of(find_part(kind, name))
import flows.cli.app
print(*({"torch", "numba", "cv2", "transformers", "prefect"} & sys.modules.keys()))
"""


def test_the_declarations_of_all_parts_load_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
