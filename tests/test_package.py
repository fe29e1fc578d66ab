"""Side effects of importing the library."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

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


LIGHT = "import sys, slgaussian; assert not {'torch', 'numba', 'cv2'} & set(sys.modules)"

# What Windows and macOS have not, and no /proc.
ELSEWHERE = """
import os, pathlib, signal, sys
import numpy, numba, torch  # which ask for them as they are on their own system
for module, name in ((os, "sched_getaffinity"), (os, "register_at_fork"), (os, "getuid"),
                     (signal, "pthread_sigmask")):
    delattr(module, name)
sys.modules["pwd"] = sys.modules["resource"] = None
plain = pathlib.Path.read_text
def read_text(path, *options, **more):
    if str(path).startswith("/proc"):
        raise FileNotFoundError(path)
    return plain(path, *options, **more)
pathlib.Path.read_text = read_text
from slgaussian import system
from slgaussian.kernels import threads, work_sharing
assert system.cores() and threads.processor()
with system.without_interrupts():
    pass
assert system.peak_memory() is None
import slgaussian as slg
sample = slg.datasets.load("procedural", seed=0, objects=3, views=4).sample(
    ["view_00", "view_03"], size=(64, 96)
)
field = slg.build_field(sample)
assert len(field.gaussians) and field.query("red").verdict
"""


@pytest.mark.parametrize(
    "program", [CHECK, LIGHT, ELSEWHERE], ids=["no pipeline", "no heavy import", "no linux"]
)
def test_package_works_in_a_new_process(program):
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_rasterize_stays_callable_after_lookup():
    for _ in range(2):
        assert callable(slgaussian.rasterize)
    with pytest.raises(slgaussian.InputError, match="unknown rasterize settings"):
        slgaussian.rasterize(SimpleNamespace(reach=float), None, 1, settings="slow")
