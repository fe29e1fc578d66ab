"""Kernels that a second process compiles ahead are those that the first one needs."""

import os
import subprocess
import sys

import pytest

from slgaussian import precompile
from slgaussian.kernels import threads

AFTERWARDS = """
from numba.core import event
from slgaussian import datasets
from slgaussian.build import build_field

class Listener(event.Listener):
    def on_start(self, event):
        print(event.data["dispatcher"].py_func.__module__)
    def on_end(self, event):
        pass

sample = datasets.load("stereo").sample(["left", "right"], size=(120, 168))
event.register("numba:compile", Listener())
build_field(sample)
"""

LATER = (
    "slgaussian.rasterize.project",
    "slgaussian.rasterize.tiles",
    "slgaussian.rasterize.blend",
    "slgaussian.masks.merge",
    "slgaussian.language.codes",
    "slgaussian.language.nearest",
)


@pytest.mark.whole
@pytest.mark.skipif(threads.cores() < 2, reason="needs two cores")
def test_precompiled_kernels_are_not_compiled_again(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    begun = precompile.begin()
    assert begun is not None and begun.wait(300) == 0
    assert precompile.begin() is None  # there are kernels now
    assert capsys.readouterr().err.count("compiling kernels") == 1
    done = subprocess.run(
        [sys.executable, "-c", AFTERWARDS], capture_output=True, text=True, env=dict(os.environ)
    )
    assert done.returncode == 0, done.stderr
    compiled = set(done.stdout.split())
    assert "slgaussian.predict.cost" in compiled  # depth, which comes first
    assert not compiled.intersection(LATER)
