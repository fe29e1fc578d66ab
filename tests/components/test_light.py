"""What commands and configurations ask of components must not make anybody wait for torch."""

import subprocess
import sys

CODE = """
import sys
import flows.config
import flows.cli.app
print(*({"torch", "numba", "cv2", "transformers", "prefect"} & sys.modules.keys()))
"""


def test_the_configs_of_all_components_load_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
