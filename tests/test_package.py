"""What importing the library may and may not do."""

import subprocess
import sys
from pathlib import Path

import pytest

import slgaussian

# Of programs: it holds the package, installed or not, and wherever the tests are started.
ROOT = Path(__file__).parents[1]

CHECK = """
import sys
import slgaussian
for name in slgaussian.__all__:
    getattr(slgaussian, name)
bad = {"prefect", "flows", "tasks", "torchvision"} & set(sys.modules)
assert not bad, bad
"""


def test_the_library_never_imports_the_pipeline():
    subprocess.run([sys.executable, "-c", CHECK], cwd=ROOT, check=True)


def test_importing_the_package_is_light():
    heavy = "import sys, slgaussian; assert not {'torch', 'numba', 'cv2'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", heavy], cwd=ROOT, check=True)


def test_an_unknown_attribute_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = slgaussian.no_such_thing


def test_rasterize_is_the_call_however_often_it_is_looked_up():
    for _ in range(2):
        assert callable(slgaussian.rasterize)
    with pytest.raises(slgaussian.InputError, match="unknown rasterize settings"):
        slgaussian.rasterize(None, None, None, settings="slow")
